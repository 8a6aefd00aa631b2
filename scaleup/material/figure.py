"""Measured points with the lines through them and their bands of confidence (PNG)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from scaleup.material.compression import Elasticity
from scaleup.material.line import CONFIDENCE, Line
from scaleup.material.yield_locus import YieldLocus
from scaleup.report import figures
from scaleup.space.grid import FloatArray

_KPA = 1e-3


def draw(path: Path, fits: Mapping[str, YieldLocus | Elasticity]) -> None:
    """A panel for each fit, under its title."""
    figure, axes = plt.subplots(
        1, len(fits), figsize=(5 * len(fits), 4), squeeze=False, layout="constrained"
    )
    for axis, (title, fit) in zip(axes.flat, fits.items(), strict=True):
        if isinstance(fit, YieldLocus):
            _locus(axis, fit)
        else:
            _unloading(axis, fit)
        axis.set_title(title, fontsize=10)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figures.save(figure, path)


def _locus(axis: Axes, locus: YieldLocus) -> None:
    axis.plot(_KPA * locus.normal, _KPA * locus.shear, "o", color="black", label="measured")
    ends = np.array([0.0, 1.05 * float(locus.normal.max())])
    _line(axis, ends, locus.line, locus.limiting, _KPA, color="C0", label="fitted")
    axis.set(xlabel="normal stress, kPa", ylabel="shear stress, kPa")
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))


def _unloading(axis: Axes, fit: Elasticity) -> None:
    stresses = (("axial", fit.axial, fit.axial_line), ("radial", fit.radial, fit.radial_line))
    for colour, (name, stress, line) in zip(("C0", "C1"), stresses, strict=True):
        axis.plot(100 * fit.strain, _KPA * stress, ".-", color=colour, lw=0.8, ms=3, label=name)
        part = fit.strain[fit.part]
        ends = np.array([part.min(), part.max()])
        _line(axis, ends, line, line, 100, color="black", lw=2)
    axis.set(xlabel="axial strain, %", ylabel="stress, kPa")


def _line(
    axis: Axes, ends: FloatArray, line: Line, limiting: Line, scale: float, **style: Any
) -> None:
    """A line between two abscissae, which are drawn times `scale`, and the band about it."""
    x = np.linspace(float(ends[0]), float(ends[1]), 100)
    axis.plot(scale * x, _KPA * line(x), **style)
    margin = limiting.margin(x)
    if margin is not None:
        label = f"{100 * CONFIDENCE:g} % limits of the line" if "label" in style else None
        low, high = limiting(x) - margin, limiting(x) + margin
        axis.fill_between(
            scale * x, _KPA * low, _KPA * high, color=style["color"], alpha=0.2, lw=0, label=label
        )
