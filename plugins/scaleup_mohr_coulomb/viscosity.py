"""The powder's viscosity by its granular fluidity: friction with a length, well-posed.

Grains that flow loosen their neighbours over a few diameters.  In the non-local rheology of
Kamrin & Koval (2012, Phys. Rev. Lett. 108, 178301) and Henann & Kamrin (2013, PNAS 110, 6730; 2014,
Int. J. Plasticity 60, 145) the ratio of shear stress to pressure is shear rate over a fluidity f
(1/s), which obeys

    t0 df/dt = A^2 d^2 lap f - (mu_s - tau/p) f - b sqrt(rho_s d^2/p) (tau/p) f^2

with the local law mu(I) = mu_s + b I.  Since tau/p = g/f with g the shear rate, and t0 is far
below a time step, that is linear in f:

    mu(I) f - A^2 d^2 lap f = g,            eta = p / f,

for this and any other mu(I).  Solved here is the non-local shear rate r = mu_s f, in quadratic
elements r, s,

    int w (mu(I)/mu_s r s + l^2 grad r.grad s) = int w g s  for all s,    w = alpha + 1e-3,
    eta = mu_s P(p) / sqrt(r^2 + eps^2),                                  l = A d / sqrt(mu_s),

with alpha the powder fraction, P the pressure with cohesion (`rheology`), eps the creep rate
(:attr:`Discretisation.creep_rate`) and l :attr:`Discretisation.nonlocal_length`.  Uniform flow
obeys tau = mu(I) P; flow fades into powder below yield as exp(-z sqrt(1 - tau/(mu_s p))/l), where
local friction would end it at once.
"""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np

from .element_shapes import ElementShapes, outer_products
from .field_system import FieldSystem
from .parameters import Discretisation
from .rheology import Strength, effective_viscosity, predicted_shear_rate

# Weight of the air: enough to define the fluidity there, too little to dilute the powder's.
_AIR_WEIGHT = 1.0e-3


class Viscosity:
    """Viscosity of the powder by the state that velocity and pressure are in.

    Attributes: ``field`` (L2, order 1, Pa s), ``shear_rate``, the non-local one, and ``pressure``
    (coefficient functions, 1/s and Pa).
    """

    def __init__(
        self,
        velocity: Any,
        pressure: Any,
        fraction: Any,
        strength: Strength,
        density: float,
        numerics: Discretisation,
        time_step: Any,
        space: Any,
        shapes: ElementShapes,
    ) -> None:
        """``space`` holds the non-local shear rate, continuous functions of order 1 or 2;
        ``time_step`` is an ngs.Parameter, s.
        """
        self._shapes, self._length = shapes, numerics.nonlocal_length
        self.pressure = pressure
        self._shear_rate = ngs.GridFunction(space)
        # quadratic functions may undershoot
        self.shear_rate = ngs.IfPos(self._shear_rate, self._shear_rate, 0.0)
        self._system = FieldSystem(space)
        strain_rate = ngs.Sym(ngs.Grad(velocity))
        local = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
        rise = strength.coefficient(local, pressure) / strength.mu_s
        self._sources = ngs.CoefficientFunction((fraction, local, rise)).Compile()

        slow_strength = strength.mu_s * strength.support(pressure)
        self.field = ngs.GridFunction(ngs.L2(space.mesh, order=1))
        expected = predicted_shear_rate(
            self.shear_rate,
            self.field * self.shear_rate,
            slow_strength,
            time_step / (density * numerics.predictor_length**2),
            numerics.predictor_threshold * time_step / numerics.time_step,
        )
        creep = numerics.creep_rate
        self._next = effective_viscosity(slow_strength, expected, creep).Compile()
        self._projected = ngs.GridFunction(self.field.space)
        self._settled = effective_viscosity(slow_strength, self.shear_rate, creep).Compile()
        self.settle()

    def settle(self) -> None:
        """The viscosity of the state as it stands, predicting nothing."""
        self._spread()
        self.field.Set(self._settled)

    def update(self) -> None:
        """Find the non-local shear rate, then the viscosity that the next step sees."""
        self._spread()
        self._projected.Set(self._next)
        self.field.vec.data = self._projected.vec

    def _spread(self) -> None:
        shapes, system = self._shapes, self._system
        fraction, local, rise = np.moveaxis(shapes.sampled(self._sources), -1, 0)
        weight = shapes.weights * (fraction + _AIR_WEIGHT)
        count = system.dofs.shape[1]
        values = shapes.values[:, :count]
        for some, slopes in shapes.chunks():
            root = np.sqrt(weight[some])[..., None]
            rows = [root * np.sqrt(rise[some])[..., None] * values]
            rows += [
                self._length * root * slopes[:, :, :count, axis] for axis in range(shapes.dimension)
            ]
            system.blocks[some] = outer_products(np.concatenate(rows, axis=1))
        system.update()
        coefficients = self._shear_rate.vec.FV().NumPy()
        coefficients[:] = system.solve((weight * local) @ values, coefficients)
