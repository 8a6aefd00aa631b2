"""`results.h5`: fields over time, pictures of single revolutions, and `results.xdmf` for ParaView.

The file is written by the root and grows by an instant at a time inside the work folder; it is
published with it when the run is complete. Fields are in single precision (the checkpoint keeps
the state in double), dense over the grid and compressed, so that they are a uniform grid to every
reader; the part without bed costs next to nothing. Datasets carry their SI unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from scaleup.bed_view import Picture
from scaleup.errors import InputError
from scaleup.files import replacing, write_text
from scaleup.flow_field import Axis, FlowField, Interval
from scaleup.grid import FloatArray, Grid, IntArray
from scaleup.storage import FORMAT_VERSION, read_grid, write_grid

PHASES, FRAMES = 8, 32  # pictures of a revolution: to be seen side by side, and one by one
_PICTURE_CELLS = 2e6  # of the grid of pictures, at most: more is not seen
_FIELD = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


@dataclass(frozen=True)
class Motion:
    """How the grid of a run moves: what turns its fields into the lab's frame.

    frame, axis, angular_velocity -- as of the FlowField
    """

    frame: str
    axis: Axis
    angular_velocity: float

    def phase(self, revolution: float) -> float:
        """Rad by which the grid has turned."""
        return 2 * math.pi * revolution if self.frame == "vessel" else 0.0

    def time(self, revolution: float) -> float:
        """S since the start."""
        return 2 * math.pi * revolution / self.angular_velocity


class Results:
    """The fields of a run, written as it goes on and read one instant at a time."""

    def __init__(self, folder: Path, grid: Grid, motion: Motion):
        self._path, self._xdmf = folder / "results.h5", folder / "results.xdmf"
        self.grid, self.motion = grid, motion
        shares = (grid.cells / _PICTURE_CELLS) ** (1 / grid.dimension)
        self._factor = max(1, math.ceil(shares - 1e-9))
        self._coarse = grid.coarsened(self._factor)
        self._with_velocity: dict[tuple[float, float], str] = {}  # snapshots by their interval

    @classmethod
    def of(cls, folder: Path, flow: FlowField) -> Results:
        """The results of a run on a flow, to be written to a folder."""
        return cls(folder, flow.grid, Motion(flow.frame, flow.axis, flow.angular_velocity))

    @classmethod
    def open(cls, folder: Path) -> Results:
        """The results that a run folder holds. Raises InputError if it holds none."""
        path = folder / "results.h5"
        if not path.exists():
            raise InputError(f"{folder}: is not a run folder ({path.name} is missing)")
        with h5py.File(path, "r") as file:
            if file.attrs.get("format_version") != FORMAT_VERSION or "frame" not in file.attrs:
                raise InputError(f"{path}: is of another version of scaleup; simulate it again")
            point, direction = file.attrs["axis_point"], file.attrs["axis_direction"]
            axis = Axis((*map(float, point),), (*map(float, direction),))  # type: ignore[arg-type]
            omega = float(file.attrs["angular_velocity"])
            return cls(folder, read_grid(file), Motion(file.attrs["frame"], axis, omega))

    def create(self) -> None:
        """Begin an empty file."""
        with replacing(self._path) as temporary, h5py.File(temporary, "w") as file:
            file.attrs["format_version"] = FORMAT_VERSION
            file.attrs["frame"] = self.motion.frame
            file.attrs["axis_point"] = self.motion.axis.point
            file.attrs["axis_direction"] = self.motion.axis.direction
            file.attrs["angular_velocity"] = self.motion.angular_velocity
            write_grid(file, self.grid)
            file.create_group("snapshots")
            write_grid(file.create_group("pictures"), self._coarse)

    def add(
        self, revolution: float, interval: Interval, time: float, concentration: FloatArray
    ) -> None:
        """Append all fields at one time; cells without bed hold NaN, and no fill.

        A flow that repeats has the same velocities every turn: they are stored once, and linked.
        """
        fields = {"fill_fraction": interval.fill(time) / self.grid.cell_volume}
        fields |= {f"concentration_{k + 1}": c for k, c in enumerate(concentration)}
        key, name = (interval.start, interval.end), _name(revolution)
        known = self._with_velocity.setdefault(key, name)
        if known == name:
            for axis, component in enumerate(interval.velocity(self.grid)):
                fields["velocity_" + "xyz"[axis]] = component
        self._append("snapshots", revolution, self.grid, interval.cells, fields)
        if known != name:
            with h5py.File(self._path, "a") as file:
                stored = file["snapshots"]
                for field in [f for f in stored[known] if f.startswith("velocity")]:
                    stored[name][field] = stored[known][field]

    def add_picture(
        self, revolution: float, interval: Interval, time: float, concentration: FloatArray
    ) -> None:
        """Append what pictures show: fill and component 1, on cells merged to 2e6 at most."""
        fill = interval.fill(time)
        cells, content = interval.cells, fill * concentration[0]
        if self._factor > 1:
            position = np.unravel_index(cells, self.grid.shape)
            merged = np.ravel_multi_index(
                tuple(p // self._factor for p in position), self._coarse.shape
            )
            cells, place = np.unique(merged, return_inverse=True)
            fill, content = (np.bincount(place, weights=w).astype(float) for w in (fill, content))
        share = np.divide(content, fill, out=np.full(len(fill), np.nan), where=fill > 0)
        fields = {"fill_fraction": fill / self._coarse.cell_volume, "concentration_1": share}
        self._append("pictures", revolution, self._coarse, cells, fields)

    def revolutions(self, kind: str = "snapshots") -> list[float]:
        """When snapshots (or "pictures") were taken, ascending."""
        with h5py.File(self._path, "r") as file:
            return [
                float(group.attrs["revolution"])
                for group in file[kind].values()
                if isinstance(group, h5py.Group) and "revolution" in group.attrs
            ]

    def snapshot(self, revolution: float) -> dict[str, NDArray[np.float32]]:
        """All fields at one of the revolutions, by name, `grid.shape`."""
        with h5py.File(self._path, "r") as file:
            group = file["snapshots"][_name(revolution)]
            return {name: np.asarray(data) for name, data in group.items()}

    def picture(self, revolution: float, kind: str = "pictures") -> Picture:
        """What a picture shows at one of the revolutions of a kind."""
        with h5py.File(self._path, "r") as file:
            group = file[kind][_name(revolution)]
            return Picture(
                self._coarse if kind == "pictures" else self.grid,
                self.motion.axis,
                revolution,
                self.motion.phase(revolution),
                np.asarray(group["fill_fraction"]),
                np.asarray(group["concentration_1"]),
            )

    def write_xdmf(self) -> None:
        """Describe the snapshots as a time series (s) of a uniform grid.

        A cross-section is one layer of cells as thick as it stands for: VTK's readers put meshes
        in the plane into the plane of y and z.
        """
        grid = self.grid
        layers, origin, edges = grid.shape, grid.lower[::-1], grid.spacing[::-1]
        if grid.dimension == 2:
            layers, origin, edges = (1, *layers), (0.0, *origin), (grid.depth, *edges)
        nodes = " ".join(str(n + 1) for n in layers)
        shape = " ".join(str(n) for n in layers)
        lower, spacing = (" ".join(repr(float(x)) for x in triple) for triple in (origin, edges))
        item = '<DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">'
        parts = []
        with h5py.File(self._path, "r") as file:
            for name, group in file["snapshots"].items():
                attributes = "".join(
                    f'<Attribute Name="{field}" AttributeType="Scalar" Center="Cell">'
                    f'<DataItem Dimensions="{shape}" NumberType="Float" Precision="4" '
                    f'Format="HDF">results.h5:/snapshots/{name}/{field}</DataItem></Attribute>'
                    for field in group
                )
                time = self.motion.time(float(group.attrs["revolution"]))
                parts.append(
                    f'<Grid Name="bed" GridType="Uniform"><Time Value="{time!r}"/>'
                    f'<Topology TopologyType="3DCoRectMesh" Dimensions="{nodes}"/>'
                    '<Geometry GeometryType="ORIGIN_DXDYDZ">'
                    f"{item}{lower}</DataItem>{item}{spacing}</DataItem>"
                    f"</Geometry>{attributes}</Grid>"
                )
        write_text(
            self._xdmf,
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>'
            '<Grid Name="blend" GridType="Collection" CollectionType="Temporal">\n'
            + "\n".join(parts)
            + "\n</Grid></Domain></Xdmf>\n",
        )

    def _append(
        self,
        kind: str,
        revolution: float,
        grid: Grid,
        cells: IntArray,
        fields: Mapping[str, FloatArray],
    ) -> None:
        with h5py.File(self._path, "a") as file:
            parent: Any = file[kind]
            name = _name(revolution)
            if name in parent:  # a resumed run repeats what came after its checkpoint
                del parent[name]
            group = parent.create_group(name)
            group.attrs["revolution"] = revolution
            for field, values in fields.items():
                empty = 0.0 if field == "fill_fraction" else np.nan
                whole = np.full(grid.cells, empty, dtype=np.float32)
                whole[cells] = values
                data = group.create_dataset(field, data=whole.reshape(grid.shape), **_FIELD)
                data.attrs["unit"] = "m/s" if field.startswith("velocity") else "1"


def instants(which: Literal["first", "last"], last: float, count: int) -> list[float]:
    """Revolutions at which pictures are taken: `count` to a turn, from start to end of one.

    last -- revolutions of the whole run; one of a single turn or less has no last turn.
    """
    if which == "last" and last <= 1.0:
        return []
    start = 0.0 if which == "first" else last - 1.0
    return [
        round(start + n / count, 9) for n in range(count + 1) if start + n / count <= last + 1e-9
    ]


def _name(revolution: float) -> str:
    return f"{revolution:012.6f}"
