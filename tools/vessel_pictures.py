"""Draws docs/figures/vessels.png: each vessel in 3-D at rest, with its axis of rotation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from netgen.meshing import MeshingStep
from netgen.occ import OCCGeometry

from scaleup.system import registry

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "figures" / "vessels.png"
VESSELS: list[tuple[str, str, dict[str, Any]]] = [
    ("drum", "drum, end walls, 4 baffles", {"end_walls": True, "baffles": 4}),
    ("tote", "tote, tilt 15 deg", {"tilt": "15 deg"}),
    ("tote", "tote with a baffle", {"baffle": True}),
    ("v-blender", "v-blender", {}),
]


def _triangles(vessel: Any) -> np.ndarray:
    """Triangles of the solid's surface, m, (n, 3, 3)."""
    size = float(np.subtract(vessel.upper, vessel.lower).max())
    mesh = OCCGeometry(vessel.solid()).GenerateMesh(
        maxh=size / 20, perfstepsend=MeshingStep.MESHSURFACE
    )
    faces = np.array([[v.nr - 1 for v in element.vertices] for element in mesh.Elements2D()])
    return np.asarray(mesh.Coordinates())[faces]


def _draw(axis: Any, vessel: Any, title: str) -> None:
    corners = _triangles(vessel)[..., [2, 0, 1]] * 1e3  # z to the right, y up
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    light = 0.55 + 0.45 * np.abs(normal @ np.array([0.4, -0.7, 0.6]))
    colour = np.clip(light[:, None] * np.array([0.45, 0.65, 0.85]), 0, 1)
    shaded = np.column_stack([colour, np.full(len(colour), 0.35)])
    axis.add_collection3d(Poly3DCollection(corners, facecolors=shaded, edgecolors="none"))
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    reach = 0.65 * (high[0] - low[0])
    axis.plot([-reach, reach], [0, 0], [0, 0], "k-.", lw=1)
    middle, half = 0.5 * (low + high), 0.55 * (high - low).max()
    axis.set(
        xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half),
        zlim=(middle[2] - half, middle[2] + half), xlabel="z, mm", ylabel="x, mm", zlabel="y, mm",
    )  # fmt: skip
    axis.set_box_aspect((1, 1, 1))
    axis.view_init(elev=18, azim=-60)
    axis.set_title(f"{title}\n{1e3 * vessel.volume:.3g} litres", fontsize=10)


def main() -> None:
    """Draw all vessels at lab size side by side."""
    figure = plt.figure(figsize=(4 * len(VESSELS), 4.4))
    figure.subplots_adjust(left=0.0, right=0.96, bottom=0.06, top=0.86, wspace=0.16)
    for number, (name, title, options) in enumerate(VESSELS, start=1):
        plugin = registry.load("geometry", name)
        vessel = plugin(plugin.Options.model_validate(options))
        _draw(figure.add_subplot(1, len(VESSELS), number, projection="3d"), vessel, title)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=80, metadata={"Software": "scaleup"})


if __name__ == "__main__":
    main()
