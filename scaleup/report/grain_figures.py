"""Grains of a particle run: kept in `grains.h5`, drawn as discs coloured by component."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import EllipseCollection
from numpy.typing import NDArray

from scaleup.report.figures import save
from scaleup.space.grid import FloatArray, IntArray
from scaleup.system import hdf5

_MM = 1e3
_PANELS = 6


@dataclass(frozen=True)
class StoredGrains:
    """Grains at some revolutions, in the lab.

    radius, component -- (n,), m and numbers from 1
    slab              -- m along z, about z = `middle`, from which pictures show grains
    position          -- m, (n, 3), by revolution
    """

    radius: FloatArray
    component: IntArray
    middle: float
    slab: float
    position: Mapping[float, NDArray[Any]]


def write_grains(path: Path, grains: StoredGrains, velocity: Mapping[float, FloatArray]) -> None:
    """Write `grains.h5`; velocity in m/s, (n, 3), by revolution."""
    with hdf5.replaced(path) as file:
        file.attrs["middle"], file.attrs["slab"] = grains.middle, grains.slab
        file.create_dataset("radius", data=grains.radius.astype(np.float32)).attrs["unit"] = "m"
        file.create_dataset("component", data=grains.component.astype(np.int32))
        for revolution, position in grains.position.items():
            group = file.create_group(f"{revolution:012.6f}")
            group.attrs["revolution"] = revolution
            for name, values, unit in (
                ("position", position, "m"), ("velocity", velocity[revolution], "m/s"),
            ):  # fmt: skip
                data = group.create_dataset(name, data=np.asarray(values, dtype=np.float32))
                data.attrs["unit"] = unit


def read_grains(path: Path) -> StoredGrains:
    """Read `grains.h5`. Raises DamagedFileError."""
    with hdf5.reading(path) as file:
        instants = [file[name] for name in file if "revolution" in file[name].attrs]
        return StoredGrains(
            np.asarray(file["radius"], dtype=float),
            np.asarray(file["component"], dtype=np.int64),
            float(file.attrs["middle"]),
            float(file.attrs["slab"]),
            {float(g.attrs["revolution"]): np.asarray(g["position"]) for g in instants},
        )


def grains(path: Path, stored: StoredGrains) -> None:
    """Draw the grains within the slab as seen along the axis, at up to six revolutions."""
    known = sorted(stored.position)
    chosen = [
        known[i] for i in np.unique(np.linspace(0, len(known) - 1, _PANELS).round().astype(int))
    ]
    columns = min(3, len(chosen))
    rows = math.ceil(len(chosen) / columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.8 * columns, 3.4 * rows), squeeze=False, layout="constrained"
    )
    colours = plt.get_cmap("coolwarm")(np.linspace(1, 0, int(stored.component.max())))
    everything = np.concatenate([stored.position[r][:, :2] for r in known])
    low, high = _MM * everything.min(axis=0), _MM * everything.max(axis=0)
    for axis, revolution in zip(axes.flat, chosen, strict=False):
        position = stored.position[revolution]
        shown = np.flatnonzero(np.abs(position[:, 2] - stored.middle) <= 0.5 * stored.slab)
        shown = shown[np.argsort(position[shown, 2])]
        width = 2 * _MM * stored.radius[shown]
        axis.add_collection(
            EllipseCollection(
                width, width, np.zeros(len(shown)), units="xy", linewidths=0,
                offsets=_MM * position[shown, :2], transOffset=axis.transData,
                facecolors=colours[stored.component[shown] - 1],
            )
        )  # fmt: skip
        margin = 2 * _MM * float(stored.radius.max())
        axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axis.set_aspect("equal")
        axis.set_title(f"{revolution:.2f} revolutions", fontsize=10)
        axis.set(xlabel="x, mm", ylabel="y, mm")
    for axis in axes.flat[len(chosen) :]:
        axis.axis("off")
    save(figure, path)
