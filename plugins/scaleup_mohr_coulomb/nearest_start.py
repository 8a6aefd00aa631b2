"""Mean flows of one drum that begin those of other speeds, fills and friction angles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from scaleup.contract import Memory, Scene

if TYPE_CHECKING:
    from .steady import SteadyBed
    from .two_phase import TwoPhaseFlow

# Differences of the friction angle (rad) and of the logarithms of speed and fill that count alike;
# a flow that is farther than one of them in all begins nothing.
_UNITS = (math.radians(10.0), math.log(2.0), math.log(1.25))
# Straight sides of elements leave nodes on a curved wall outside by less.
_INWARDS = 1e-3


@dataclass(frozen=True)
class Start:
    """A mean flow at the nodes of its own mesh: (n, 2) m, (n, 2) m/s and the signed distance, m.

    ``place`` (3,) is its friction angle, rad, and the logarithms of its speed, rad/s, and fill,
    m^3; ``distance`` that from the flow that is to begin, 0 to 1.
    """

    nodes: NDArray[Any]
    velocities: NDArray[Any]
    levels: NDArray[Any]
    place: NDArray[Any]
    distance: float

    def begin(self, flow: TwoPhaseFlow) -> None:
        """Put a flow there: turned by the difference of the friction angles, by its own speed."""
        angle, speed, _ = self.place
        turn = flow.material.friction_angle - angle
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        faster = flow.drive.angular_velocity / math.exp(speed)
        values = np.column_stack([self.levels, faster * self.velocities @ rotation.T])
        linear, nearest = (
            interpolator(self.nodes, values)
            for interpolator in (LinearNDInterpolator, NearestNDInterpolator)
        )
        points = (1.0 - _INWARDS) * flow.level_set.nodes @ rotation
        found = linear(points)
        found = np.where(np.isnan(found), nearest(points), found)
        flow.begin(found[:, 0], found[:, 1:])


class Starts:
    """The mean flows that a :class:`Memory` keeps of one drum and powder, solved in one way."""

    def __init__(self, memory: Memory, scene: Scene, solved: Mapping[str, Any]) -> None:
        """``solved`` is JSON-like: what else the flows are equal in."""
        self._memory = memory
        material = dict(scene.inputs["material"])
        del material["friction_angle"]
        equal = {"geometry": scene.inputs["geometry"], "material": material, **solved}
        self._shelf = {"stage": "starts", **equal}
        speed, fill = math.log(scene.speed), math.log(scene.fill_volume)
        self._place = np.array([scene.material.friction_angle, speed, fill])

    def nearest(self) -> Start | None:
        """The one whose friction angle, speed and fill are nearest, if it is near enough."""
        places = self._places()
        distances = np.linalg.norm((places - self._place) / _UNITS, axis=1)
        for number in np.argsort(distances, kind="stable"):
            kept = self._memory.recall(self._entry(places[number]))
            if distances[number] <= 1.0 and kept is not None:
                return Start(**kept, place=places[number], distance=float(distances[number]))
        return None

    def keep(self, bed: SteadyBed) -> None:
        """Add the mean flow of the scene."""
        nodes, level_set = bed.level_set.nodes, bed.level_set
        parts = np.split(bed.velocity.vec.FV().NumPy(), 2)
        arrays = {
            "nodes": nodes,
            "velocities": np.column_stack([level_set.nodal(part) for part in parts]),
            "levels": level_set.nodal(level_set.field.vec.FV().NumPy()),
        }
        self._memory.keep(self._entry(self._place), arrays)
        places = self._places()
        others = places[(places != self._place).any(axis=1)]
        self._memory.keep(self._shelf, {"places": np.concatenate([others, [self._place]])})

    def _places(self) -> NDArray[Any]:
        kept = self._memory.recall(self._shelf)
        return np.empty((0, 3)) if kept is None else kept["places"]

    def _entry(self, place: NDArray[Any]) -> dict[str, Any]:
        return self._shelf | {"place": place.tolist()}


def described(place: NDArray[Any]) -> str:
    """A `Start.place`, or ``rest`` for one that is none (NaN)."""
    angle, speed, fill = place
    if np.isnan(angle):
        return "rest"
    return (
        f"the mean flow at a friction angle of {math.degrees(angle):.4g} deg, "
        f"{math.exp(speed) * 30 / math.pi:.4g} rpm and a fill of {1e3 * math.exp(fill):.4g} l"
    )
