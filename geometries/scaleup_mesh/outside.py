"""A program, `python outside.py FILE FOLDER`: triangles of a mesh's or a CAD solid's outside.

Readers written in C++ end their process, or never end, on damaged files; `apart` therefore runs
this in one of its own. It imports nothing of scaleup, so as to start fast. FOLDER then holds
`surface.npz` (vertices (v, 3), triangles (n, 3), and whether they bound volume cells), or
`reason.txt`: why there is none, which begins with "refused: " if the file was read well.
"""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np

_MEMORY, _SECONDS = 8 * 2**30, 300  # bytes and processor time that a reader may take
_STEP = (".step", ".stp")
_LEGACY, _XML = (".vtk",), (".vtu", ".vtp", ".vts", ".vtr", ".vti", ".pvtu", ".pvtp")
_EDGES = 75  # triangle edges along the longest side of a solid's box
_PER_RADIUS = 12  # triangle edges along a radius of curvature
_FLAT = 1e-15  # volume over the cube of the size, below which a cell has none


class UselessError(Exception):
    """The file was read well, but what it holds is of no use."""


def main(file: Path, folder: Path) -> None:
    """Write what FILE holds into FOLDER."""
    _limit()
    try:
        suffix = file.suffix.lower()
        if suffix in _STEP:
            surface = (*_of_solid(file, folder), False)
        elif suffix in _LEGACY + _XML:
            surface = _of_dataset(_read_vtk(file, suffix in _XML))
        else:
            surface = _of_dataset(_read_vtk(_as_vtu(file, folder), True))
        names = ("vertices", "triangles", "bound_cells")
        np.savez(folder / "surface.npz", **dict(zip(names, surface, strict=True)))
    except (Exception, SystemExit) as error:  # the readers raise whatever their parsers do
        kind = "refused: " if isinstance(error, UselessError) else ""
        reason = " ".join(str(error).split()) or type(error).__name__
        (folder / "reason.txt").write_text(kind + reason, encoding="utf-8")


def _limit() -> None:
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _of_solid(file: Path, folder: Path) -> tuple[Any, Any]:
    """Of the one solid of a STEP file, in mm."""
    from netgen.meshing import MeshingStep
    from netgen.occ import OCCGeometry

    plain = folder / "solid.step"  # netgen knows a STEP file by its name's end, in small letters
    plain.symlink_to(file)
    geometry = OCCGeometry(str(plain))
    solids = len(geometry.shape.solids)
    if solids != 1:
        raise UselessError(f"holds {solids} solids; give the inside of the vessel as one")
    low, high = (np.array([p.x, p.y, p.z]) for p in geometry.shape.bounding_box)
    mesh = geometry.GenerateMesh(
        maxh=float((high - low).max()) / _EDGES,
        curvaturesafety=_PER_RADIUS,
        perfstepsend=MeshingStep.MESHSURFACE,
    )
    triangles = np.array([[v.nr - 1 for v in element.vertices] for element in mesh.Elements2D()])
    return np.array(mesh.Coordinates()), triangles  # a copy: the mesh's own goes with the mesh


def _as_vtu(file: Path, folder: Path) -> Path:
    """The file, of any format that meshio reads, as VTU."""
    import meshio

    with contextlib.redirect_stdout(io.StringIO()) as said:
        try:
            mesh = meshio.read(file)
        except SystemExit:
            raise ValueError(said.getvalue() or "meshio gives no reason") from None
        if np.asarray(mesh.points).shape[1] != 3:
            raise UselessError("holds points in two dimensions; a vessel needs three")
        plain = folder / "mesh.vtu"
        meshio.Mesh(mesh.points, mesh.cells).write(plain)
    return plain


def _read_vtk(file: Path, is_xml: bool) -> Any:
    """The data set of a VTK file. Raises ValueError with what its reader complained of."""
    from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
    from vtkmodules.vtkIOXML import vtkXMLGenericDataObjectReader

    reader = vtkXMLGenericDataObjectReader() if is_xml else vtkGenericDataObjectReader()
    reader.SetFileName(str(file))
    _run(reader)
    return reader.GetOutput()


def _run(algorithm: Any) -> None:
    """Run a reader or filter of VTK. Raises ValueError with its first complaint."""
    complaints: list[str] = []

    def hear(source: Any, event: str, text: str) -> None:
        complaints.append(text.strip().splitlines()[-1].split("): ", 1)[-1].rstrip("."))

    hear.CallDataType = "string0"  # type: ignore[attr-defined]
    algorithm.AddObserver("ErrorEvent", hear)
    algorithm.GetExecutive().AddObserver("ErrorEvent", hear)
    algorithm.Update()
    if complaints:
        raise ValueError(complaints[0])


def _of_dataset(data: Any) -> tuple[Any, Any, bool]:
    """Of a VTK data set's volume cells, else its faces; curved ones are cut at their nodes."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

    if data is None or not data.IsA("vtkPointSet"):
        kind = data.GetClassName() if data is not None else "nothing"
        raise UselessError(f"holds {kind}; a surface mesh or a volume mesh is needed")
    if data.GetNumberOfPoints() == 0:
        raise UselessError("holds no points")
    if not np.isfinite(vtk_to_numpy(data.GetPoints().GetData())).all():
        raise UselessError("holds coordinates that are not finite")
    bound_cells = False
    if data.IsA("vtkUnstructuredGrid"):
        data, bound_cells = _cells_of_one_dimension(data)
    elif data.IsA("vtkStructuredGrid"):
        bound_cells = True
    surface = vtkDataSetSurfaceFilter()
    surface.SetInputData(data)
    triangles = vtkTriangleFilter()
    triangles.SetInputConnection(surface.GetOutputPort())
    triangles.PassVertsOff()
    triangles.PassLinesOff()
    _run(triangles)
    outside = triangles.GetOutput()
    if outside.GetNumberOfPolys() == 0:
        raise UselessError("holds no faces and no volume cells")
    corners = vtk_to_numpy(outside.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    points = vtk_to_numpy(outside.GetPoints().GetData())
    return points.astype(float), corners.astype(np.int64), bound_cells


def _cells_of_one_dimension(grid: Any) -> tuple[Any, bool]:
    """The grid's volume cells, that share equal points, if it has any; else its faces."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkStaticCleanUnstructuredGrid
    from vtkmodules.vtkFiltersExtraction import vtkExtractCellsByType
    from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter

    if grid.GetNumberOfCells() == 0:
        raise UselessError("holds no cells")
    kinds, first = np.unique(vtk_to_numpy(grid.GetCellTypesArray()), return_index=True)
    dimension = {
        int(kind): grid.GetCell(int(k)).GetCellDimension()
        for kind, k in zip(kinds, first, strict=True)
    }
    wanted = max(dimension.values())
    chosen = vtkExtractCellsByType()
    chosen.SetInputData(grid)
    for kind, its in dimension.items():
        if its == wanted:
            chosen.AddCellType(kind)
    if wanted < 3:
        _run(chosen)
        return chosen.GetOutput(), False
    clean = vtkStaticCleanUnstructuredGrid()
    clean.SetInputConnection(chosen.GetOutputPort())
    size = vtkCellSizeFilter()
    size.SetInputConnection(clean.GetOutputPort())
    _run(size)
    volumes = vtk_to_numpy(size.GetOutput().GetCellData().GetArray("Volume"))
    extent = np.ptp(vtk_to_numpy(grid.GetPoints().GetData()).astype(float), axis=0).max()
    flat = int((np.abs(volumes) <= _FLAT * extent**3).sum())
    if flat:
        raise UselessError(f"{flat} cells are degenerate (no volume); repair the mesh")
    return clean.GetOutput(), True


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
