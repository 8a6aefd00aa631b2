"""The rolling drum in closed form.

Coordinates (s, n): s down the surface from mid-bed, n along the outward normal of the flat bed
surface, which lies at distance b below the axis (n = 0 on the surface), half chord
L = sqrt(R^2 - b^2). Rigid rotation brings q(s) = omega/2 (L^2 - s^2) per depth to the surface,
which the layer carries down. With zeta = depth/delta the stream function

    psi = omega/2 (R^2 - r^2) - q(s) (1 - zeta)^2        (the second term for zeta < 1 only)

(delta no more than the depth of the bed) is 0 on the wall and on the surface, gives a velocity
linear in depth relative to rigid rotation, and joins it continuously at zeta = 1. Closures of the
thickness (Khakhar et al. 1997; Orpe & Khakhar 2001):

    shear-rate   delta = sqrt(2 q / shear_rate)             (an elliptic layer)
    parabolic    delta = delta0 (1 - s^2/L^2)               (uniform surface speed omega L^2/delta0)
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import trapezoid

from scaleup.contract import GRAVITY, FloatArray, FlowField, Geometry, Material, Scene
from scaleup.numerics import fill_to_volume, flow_from_stream_function, level_height
from scaleup_surface_layer.detectors import layer_figures, maxima

if TYPE_CHECKING:
    from scaleup_surface_layer import SurfaceLayer


_CHORD_END = 1e-3  # where the chord counts as ended: 1 - s^2/L^2


class RollingBed:
    """Geometry and stream function of the bed.

    radius, omega -- m, rad/s
    distance      -- b, m, of the surface from the axis (negative: surface above the axis)
    angle         -- rad, of the surface above the horizontal
    closure, shear_rate (1/s), thickness (m at mid-bed) -- of the layer
    """

    def __init__(
        self,
        radius: float,
        omega: float,
        distance: float,
        angle: float,
        closure: str,
        shear_rate: float,
        thickness: float | None,
    ):
        self.radius, self.omega, self.distance, self.angle = radius, omega, distance, angle
        self.half_chord_squared = radius**2 - distance**2
        self.midbed_flux = 0.5 * omega * self.half_chord_squared
        self.closure, self.shear_rate = closure, shear_rate
        self.thickness = thickness or math.sqrt(2 * self.midbed_flux / shear_rate)

    def depth_below_surface(self, points: FloatArray) -> FloatArray:
        """m, positive in the bed; points (..., 2) in lab coordinates."""
        normal = np.array([-math.sin(self.angle), math.cos(self.angle)])
        return -points @ normal - self.distance

    def along_surface(self, points: FloatArray) -> FloatArray:
        """Distance s down the surface from mid-bed, m; points (..., 2) in lab coordinates."""
        return -points @ np.array([math.cos(self.angle), math.sin(self.angle)])

    def layer_thickness(self, s: FloatArray) -> FloatArray:
        """delta(s) of the closure, m; 0 beyond the chord. The bed may be less deep at its ends."""
        inside = np.maximum(1.0 - s**2 / self.half_chord_squared, 0.0)
        if self.closure == "parabolic":
            return self.thickness * inside
        return self.thickness * np.sqrt(inside)

    def layer_shear_rate(self, points: FloatArray) -> FloatArray:
        """2 q/delta^2 of the closure at the distance s of lab points (..., 2), 1/s."""
        at_midbed = 2 * self.midbed_flux / self.thickness**2
        if self.closure == "shear-rate":
            return np.full(points.shape[:-1], at_midbed)
        s = self.along_surface(points)
        return at_midbed / np.maximum(1.0 - s**2 / self.half_chord_squared, _CHORD_END)

    def stream_function(self, points: FloatArray) -> FloatArray:
        """psi, m^2/s, at lab points (..., 2) of the bed."""
        s = self.along_surface(points)
        depth = self.depth_below_surface(points)
        radius_squared = (points**2).sum(axis=-1)
        bed_depth = np.sqrt(np.maximum(self.radius**2 - s**2, 0.0)) - self.distance
        delta = np.maximum(np.minimum(self.layer_thickness(s), bed_depth), 1e-30)
        flux = 0.5 * self.omega * np.maximum(self.half_chord_squared - s**2, 0.0)
        in_layer = np.maximum(1.0 - depth / delta, 0.0)
        return 0.5 * self.omega * (self.radius**2 - radius_squared) - flux * in_layer**2

    def velocity(self, points: FloatArray, step: float = 1e-7) -> FloatArray:
        """(dpsi/dy, -dpsi/dx) by central differences over `step` (m), m/s, shape (..., 2)."""
        ex, ey = np.array([step, 0.0]), np.array([0.0, step])
        psi = self.stream_function
        return np.stack(
            [
                (psi(points + ey) - psi(points - ey)) / (2 * step),
                -(psi(points + ex) - psi(points - ex)) / (2 * step),
            ],
            axis=-1,
        )

    def shear_rate_at(self, points: FloatArray, step: float) -> FloatArray:
        """sqrt(4 psi_xy^2 + (psi_yy - psi_xx)^2) by differences over `step` (m), 1/s."""
        ex, ey = np.array([step, 0.0]), np.array([0.0, step])
        psi = self.stream_function
        middle = psi(points)
        xx = psi(points + ex) - 2 * middle + psi(points - ex)
        yy = psi(points + ey) - 2 * middle + psi(points - ey)
        xy = 0.25 * (
            psi(points + ex + ey)
            - psi(points + ex - ey)
            - psi(points - ex + ey)
            + psi(points - ex - ey)
        )
        return np.sqrt(4 * xy**2 + (yy - xx) ** 2) / step**2


def layer_shear_rate(material: Material, options: SurfaceLayer.Options) -> float:
    """Of the closure, 1/s: as given, or sqrt(g sin(b_m - b_s) / (c d cos b_s)), c = 1.5."""
    return options.shear_rate or math.sqrt(
        GRAVITY
        * math.sin(options.angle_difference)
        / (1.5 * material.grain_diameter * math.cos(material.friction_angle))
    )


def rolling_bed(
    geometry: Geometry,
    material: Material,
    speed: float,
    fill_volume: float,
    options: SurfaceLayer.ClosedFormOptions,
) -> RollingBed:
    """The bed of a scene: b from the fill, angle atan(mu), closure from the options."""
    return RollingBed(
        geometry.reach,
        speed,
        -level_height(geometry, fill_volume),  # a circle is as deep at every angle
        math.atan(material.friction),
        options.closure,
        layer_shear_rate(material, options),
        options.thickness,
    )


def drum_flow(scene: Scene, options: SurfaceLayer.ClosedFormOptions) -> FlowField:
    """The steady lab-frame FlowField of the rolling bed on the scene's grid."""
    grid = scene.grid
    bed = rolling_bed(scene.geometry, scene.material, scene.speed, scene.fill_volume, options)
    corners = grid.corner_points()
    depth = bed.depth_below_surface(corners)
    wall = scene.geometry.signed_distance(corners)
    fill, _ = fill_to_volume(grid, depth, wall, scene.fill_volume)
    psi = np.where((depth > 0) & (wall > 0), bed.stream_function(corners), 0.0)
    centres = grid.centre_points().reshape(*grid.shape, 2)
    shear_rate = np.where(fill > 0, bed.shear_rate_at(centres, 0.25 * grid.spacing[0]), 0.0)
    # second differences where the layer meets the wall are kinks of psi, not a shear rate
    normal = np.array([-math.sin(bed.angle), math.cos(bed.angle)])
    depths = np.linspace(0.0, bed.radius - bed.distance, 2001)
    midbed = -(bed.distance + depths[:, None]) * normal
    streamwise = bed.along_surface(bed.velocity(midbed))
    reversal = float(np.interp(0.0, -streamwise, depths))
    return flow_from_stream_function(
        grid,
        psi,
        fill,
        np.minimum(shear_rate, bed.layer_shear_rate(centres)),
        axis=scene.geometry.axis,
        angular_velocity=bed.omega,
        lift=bed.angle,
        summary={
            "surface_angle_deg": math.degrees(bed.angle),
            "surface_angle_source": "input: the friction angle",
            "surface_speed_max": float(streamwise[0]),
            "active_layer_thickness": reversal,
            "solid_body_ratio": None,
            "solid_body_ratio_reason": "the model assumes rigid rotation below the layer",
            "flux_midbed": float(trapezoid(np.maximum(streamwise, 0.0), depths)),
            "volume_drift": None,
            "volume_drift_reason": "the bed is in closed form",
            **maxima(detectors(bed)),
        },
    )


def detectors(bed: RollingBed) -> dict[str, FloatArray]:
    """See `detectors`; in a circle the surface is a plane, and no wall overhangs it."""
    fall = 2 * math.sqrt(bed.half_chord_squared) * math.sin(bed.angle)
    shear_rate = 2 * bed.midbed_flux / bed.thickness**2
    figures = layer_figures(bed.midbed_flux, shear_rate, fall, bed.radius - bed.distance)
    none = dict.fromkeys(("steep", "roof", "overhang"), 0.0)
    return {name: np.array([value]) for name, value in (figures | none).items()}
