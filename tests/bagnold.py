"""Bagnold flow down an incline: its exact profile and the solver's error."""

import math
from dataclasses import replace

import ngsolve as ngs
import numpy as np
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from scaleup.scene.models import Material
from scaleup_mohr_coulomb.element_shapes import ElementShapes
from scaleup_mohr_coulomb.momentum import Momentum
from scaleup_mohr_coulomb.parameters import Discretisation, Drive, Rheology
from scaleup_mohr_coulomb.rheology import Strength
from scaleup_mohr_coulomb.viscosity import Viscosity

# Bagnold flow: depth, gravity and density 1; rough base; I_a the inertial number of the slope.
SLOPE, GRAIN = 0.43, 0.04
LAW = Rheology("mu-i", friction_rise=0.26, i_0=0.3)
MU_S = 0.38
I_A = LAW.i_0 * (math.tan(SLOPE) - MU_S) / (MU_S + LAW.friction_rise - math.tan(SLOPE))
SURFACE_SPEED = 2 / 3 * I_A / GRAIN * math.sqrt(math.cos(SLOPE))


def bagnold_error(dimension: int, layers: int, time_step: float = 0.3) -> float:
    """Relative L2 error of the velocity once the flow no longer changes."""
    cells = {f"periodic_{axis}": True for axis in "xy"[: dimension - 1]}
    if dimension == 2:
        mesh = MakeStructured2DMesh(
            quads=False, nx=2, ny=layers, **cells, mapping=lambda x, y: (2 * x, y)
        )
        depth, down = 1.0 - ngs.y, np.array((math.sin(SLOPE), -math.cos(SLOPE)))
    else:
        mesh = MakeStructured3DMesh(
            hexes=False,
            nx=2,
            ny=2,
            nz=layers,
            **cells,
            mapping=lambda x, y, z: (2 * x, 2 * y, z),
        )
        depth, down = 1.0 - ngs.z, np.array((math.sin(SLOPE), 0.0, -math.cos(SLOPE)))
    material = Material.model_construct(  # without dimensions: no powder is as light
        bulk_density=1.0,
        grain_density=1.0 + 1e-9,
        friction_angle=math.atan(MU_S),
        grain_diameter=GRAIN,
        wall_friction=1.0,
    )
    numerics = replace(
        Discretisation.by_rule(material, Drive(1.0, 0.1, gravity=1.0), 1.0, time_step=time_step),
        nonlocal_length=0.0,
        creep_rate=1e-6,
        slip_speed=1e-5,
        air_density=0.0,
        air_viscosity=1e-9,
    )
    linear = ngs.Compress(ngs.Periodic(ngs.H1(mesh, order=1)))
    quadratic = ngs.Compress(ngs.Periodic(ngs.VectorH1(mesh, order=2)))
    solution, previous = ngs.GridFunction(quadratic * linear), ngs.GridFunction(quadratic)
    velocity, pressure = solution.components
    below = ngs.IfPos(depth, depth, 0.0)
    exact = ngs.CoefficientFunction((SURFACE_SPEED * (1.0 - below**1.5), *[0.0] * (dimension - 1)))
    velocity.Set(exact)
    pressure.Set(math.cos(SLOPE) * depth)
    powder, step = ngs.CoefficientFunction(1.0), ngs.Parameter(time_step)
    shapes = ElementShapes(mesh)
    viscosity = Viscosity(
        velocity, pressure, powder, Strength.of(material, LAW), 1.0, numerics, step, linear, shapes
    )
    momentum = Momentum(
        solution,
        previous,
        viscosity,
        powder,
        material,
        numerics,
        step,
        force=lambda points, velocity: down,
        wall_velocity=ngs.CoefficientFunction((0.0,) * dimension),
        shapes=shapes,
        wall="bottom|top",
    )
    top = mesh.Boundaries("top")
    area = ngs.Integrate(1.0, mesh, definedon=top)
    for _ in range(600):
        viscosity.update()
        momentum.step()
        pressure.vec.FV().NumPy()[:] -= ngs.Integrate(pressure, mesh, definedon=top) / area
        difference = np.abs(velocity.vec.FV().NumPy() - previous.vec.FV().NumPy())
        change = difference.max() / time_step
        if change < 5e-6:
            break
    assert change < 5e-6
    error = velocity - exact
    return math.sqrt(
        ngs.Integrate(error * error, mesh, order=8) / ngs.Integrate(exact * exact, mesh, order=8)
    )
