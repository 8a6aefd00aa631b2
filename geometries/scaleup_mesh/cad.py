"""STEP files through netgen's OCC, which reads them in millimetres."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from netgen.occ import Axis, Dir, OCCGeometry, Pnt, Vec
from scipy.spatial.transform import Rotation

from scaleup.contract import FloatArray

_MM = 1e-3


def read_solid(file: Path, origin: FloatArray, turn: FloatArray) -> Any:
    """The solid in the vessel's frame, m: moved by -origin (m), then turned (3, 3)."""
    with tempfile.TemporaryDirectory(prefix="scaleup-") as folder:
        plain = Path(folder) / "solid.step"  # netgen knows STEP by such an ending alone
        plain.symlink_to(file.resolve())
        shape = OCCGeometry(str(plain)).shape.Scale(Pnt(0, 0, 0), _MM).Move(Vec(*-origin))
    vector = Rotation.from_matrix(turn).as_rotvec()
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return shape
    return shape.Rotate(Axis(Pnt(0, 0, 0), Dir(*vector)), math.degrees(angle))
