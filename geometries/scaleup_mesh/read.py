"""Files to closed surfaces of triangles, in the files' own coordinates; checked."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import meshio
import numpy as np
import trimesh

from scaleup.api import FloatArray, InputError, IntArray

_SURFACES = (".stl", ".obj", ".ply", ".off")
_STEP = (".step", ".stp")
_FLAT = 1e-12  # area or volume over the square or cube of the size, below which a cell has none

# Facets of cells by the numbers of their corners (the first nodes of higher-order cells).
_FACETS = {
    "tetra": ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    "hexahedron": (
        (0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ),
    "wedge": ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}  # fmt: skip


def read_surface(file: Path) -> tuple[FloatArray, IntArray]:
    """Vertices (v, 3) and triangles (n, 3), outwards. Raises InputError if it is not closed."""
    where = f"geometry.file = {str(file)!r}"
    suffix = file.suffix.lower()
    try:
        if suffix in _STEP:
            from scaleup_mesh.cad import triangulated

            vertices, faces = triangulated(file)
        elif suffix in _SURFACES:
            loaded = trimesh.load_mesh(file, process=False)
            vertices, faces = np.asarray(loaded.vertices), np.asarray(loaded.faces)
        else:
            vertices, faces = _from_meshio(file)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # the readers raise whatever their parsers do
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be read as {suffix or 'a mesh'} ({reason})") from error
    return _checked(where, vertices, faces)


def _checked(where: str, vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """The one closed surface that these triangles are, outwards. Raises InputError."""
    if len(faces) == 0 or not np.all(np.isfinite(vertices)):
        raise InputError(f"{where}: holds no triangles, or coordinates that are not finite")
    mesh = trimesh.Trimesh(vertices, faces, process=True)  # joins equal vertices
    corners = np.sort(mesh.faces, axis=1)
    mesh.update_faces((corners[:, :-1] != corners[:, 1:]).all(axis=1))  # shrunk to a line by that
    mesh.remove_unreferenced_vertices()
    flat = int((mesh.area_faces <= _FLAT * mesh.scale**2).sum())
    if flat:
        raise InputError(f"{where}: {flat} triangles are degenerate (no area); repair the mesh")
    if not mesh.is_watertight:
        _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
        raise InputError(
            f"{where}: not watertight; {int((counts != 2).sum())} edges do not lie between two "
            "triangles; close the surface"
        )
    if not mesh.is_winding_consistent:
        raise InputError(
            f"{where}: neighbouring triangles have opposite orientations; orient the surface"
        )
    if mesh.body_count != 1:
        raise InputError(
            f"{where}: holds {mesh.body_count} separate surfaces; give the inside of the vessel "
            "as one, without its wall's outside"
        )
    if mesh.volume < 0:
        mesh.invert()
    return np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)


def _from_meshio(file: Path) -> tuple[FloatArray, IntArray]:
    """The boundary of a file's volume cells, else its triangles and quadrilaterals."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        mesh = meshio.read(file)
    points = np.asarray(mesh.points, dtype=float)
    if points.shape[1] != 3:
        raise ValueError("the points are not 3-D")
    facets: list[IntArray] = []
    insides: list[FloatArray] = []
    for block in mesh.cells:
        for kind, sides in _FACETS.items():
            if block.type.startswith(kind):
                corners = points[np.asarray(block.data)[:, : 1 + max(map(max, sides))]]
                _check_cells(file, kind, corners)
                for side in sides:
                    facet = np.asarray(block.data)[:, side]
                    facets.append(np.pad(facet, ((0, 0), (0, 4 - len(side))), mode="edge"))
                    insides.append(corners.mean(axis=1))
    if facets:
        return points, _outer(points, np.concatenate(facets), np.concatenate(insides))
    blocks = {"triangle": 3, "quad": 4}
    flat = [
        np.asarray(block.data)[:, :count]
        for block in mesh.cells
        for kind, count in blocks.items()
        if block.type.startswith(kind)
    ]
    if not flat:
        raise ValueError("it holds no triangles, quadrilaterals or volume cells")
    padded = [np.pad(f, ((0, 0), (0, 4 - f.shape[1])), mode="edge") for f in flat]
    return points, _split(np.concatenate(padded))


def _check_cells(file: Path, kind: str, corners: FloatArray) -> None:
    """Raise InputError for cells (n, corners, 3) that span no volume."""
    spans = corners - corners.mean(axis=1, keepdims=True)
    size = np.abs(corners - corners.min(axis=(0, 1))).max()
    thickness = np.linalg.svd(spans, compute_uv=False)[:, -1]
    flat = int((thickness <= _FLAT ** (1 / 3) * 1e-3 * size).sum())
    if flat:
        raise InputError(
            f"geometry.file = {str(file)!r}: {flat} cells of kind {kind} are degenerate (no "
            "volume); repair the mesh"
        )


def _outer(points: FloatArray, facets: IntArray, insides: FloatArray) -> IntArray:
    """Triangles of the facets (n, 4) of one cell alone, turned away from the cells' centres."""
    key = facets.copy()
    key[facets[:, 2] == facets[:, 3], 3] = -1  # whichever corner a triangle repeats
    key.sort(axis=1)
    _, first, counts = np.unique(key, axis=0, return_index=True, return_counts=True)
    outer = first[counts == 1]
    triangles = _split(facets[outer])
    source = np.concatenate([outer, outer[facets[outer][:, 2] != facets[outer][:, 3]]])
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inwards = np.einsum("ij,ij->i", normal, corner[:, 0] - insides[source]) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return triangles


def _split(facets: IntArray) -> IntArray:
    """Triangles of facets (n, 4), first all first halves; a triangle repeats its last corner."""
    quads = facets[facets[:, 2] != facets[:, 3]]
    return np.concatenate([facets[:, :3], quads[:, [0, 2, 3]]]).astype(np.int64)
