"""The powder's viscosity, taken from a shear rate and a pressure filtered over a length.

Constant friction is ill-posed without a length: the viscosity sees shear rate and pressure
through a filter of length l (:attr:`Discretisation.filter_length`),

    int (alpha + 1e-3) (g s + l^2 grad g.grad s) = int (alpha + 1e-3) sqrt(2 E:E) s  for all s,

and likewise for the pressure, with alpha the powder fraction and quadratic elements g, s (with
linear ones a drum's layer at h = 3 l is off its converged depth by 5 instead of 3 %).
"""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np

from .element_shapes import ElementShapes, outer_products
from .field_system import FieldSystem
from .parameters import Discretisation
from .rheology import Strength, effective_viscosity, predicted_shear_rate

# Weight of the air in the filter: enough to define it there, too little to dilute the powder.
_AIR_WEIGHT = 1.0e-3


class Viscosity:
    """Viscosity of the powder by the state that velocity and pressure are in.

    Attributes: ``field`` (L2, order 1, Pa s), ``shear_rate`` and ``pressure``, the filtered ones
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
        """``space`` holds the filtered fields, continuous functions of order 1 or 2; ``time_step``
        is an ngs.Parameter, s.
        """
        self._shapes, self._filter_length = shapes, numerics.filter_length
        self._shear_rate, self.pressure = ngs.GridFunction(space), ngs.GridFunction(space)
        # quadratic functions may undershoot
        self.shear_rate = ngs.IfPos(self._shear_rate, self._shear_rate, 0.0)
        self._filter = FieldSystem(space)
        strain_rate = ngs.Sym(ngs.Grad(velocity))
        shear_rate = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
        self._sources = ngs.CoefficientFunction((fraction, shear_rate, pressure)).Compile()

        strength_now = strength(self.shear_rate, self.pressure)
        self.field = ngs.GridFunction(ngs.L2(space.mesh, order=1))
        expected = predicted_shear_rate(
            self.shear_rate,
            self.field * self.shear_rate,
            strength_now,
            time_step / (density * numerics.predictor_length**2),
            numerics.predictor_threshold * time_step / numerics.time_step,
        )
        creep = numerics.creep_rate
        self._next = effective_viscosity(
            strength(expected, self.pressure), expected, creep
        ).Compile()
        self._projected = ngs.GridFunction(self.field.space)
        self._filter_fields()
        self.field.Set(effective_viscosity(strength_now, self.shear_rate, creep))

    def update(self) -> None:
        """Filter shear rate and pressure, then the viscosity that the next step sees."""
        self._filter_fields()
        self._projected.Set(self._next)
        self.field.vec.data = self._projected.vec

    def _filter_fields(self) -> None:
        shapes, system = self._shapes, self._filter
        fraction, *sources = np.moveaxis(shapes.sampled(self._sources), -1, 0)
        weight = shapes.weights * (fraction + _AIR_WEIGHT)
        count = system.dofs.shape[1]
        values = shapes.values[:, :count]
        for some, slopes in shapes.chunks():
            root = np.sqrt(weight[some])[..., None]
            rows = [root * values]
            rows += [
                self._filter_length * root * slopes[:, :, :count, axis]
                for axis in range(shapes.dimension)
            ]
            system.blocks[some] = outer_products(np.concatenate(rows, axis=1))
        system.update()
        for field, source in zip((self._shear_rate, self.pressure), sources, strict=True):
            coefficients = field.vec.FV().NumPy()
            coefficients[:] = system.solve((weight * source) @ values, coefficients)
