"""The powder's viscosity, taken from a shear rate and a pressure filtered over a length.

Constant friction is ill-posed without a length: the viscosity sees shear rate and pressure
through a filter of length l (:attr:`Discretisation.filter_length`),

    int (alpha + 1e-3) (g s + l^2 grad g.grad s) = int (alpha + 1e-3) sqrt(2 E:E) s  for all s,

and likewise for the pressure, with alpha the powder fraction and linear elements g, s.
"""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np

from .block_solver import PositiveSolver
from .factors import SymmetricFactors
from .parameters import Discretisation
from .rheology import Strength, effective_viscosity, predicted_shear_rate

# Extra quadrature order for elements that the smoothed interface crosses.
CUT_CELL_ORDER = 2
# Weight of the air in the filter: enough to define it there, too little to dilute the powder.
_AIR_WEIGHT = 1.0e-3


class Viscosity:
    """Viscosity of the powder by the state that velocity and pressure are in.

    Attributes: ``field`` (L2, order 1, Pa s), ``shear_rate`` and ``pressure``, the filtered ones
    (H1, order 1, 1/s and Pa).
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
    ) -> None:
        """``space`` holds linear, continuous functions; ``time_step`` is an ngs.Parameter, s."""
        g, s = space.TnT()
        self.shear_rate, self.pressure = ngs.GridFunction(space), ngs.GridFunction(space)
        strain_rate = ngs.Sym(ngs.Grad(velocity))
        shear_rate = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
        weight = fraction + _AIR_WEIGHT
        self._filter = ngs.BilinearForm(space, symmetric=True)
        self._filter += (
            weight * (g * s + numerics.filter_length**2 * ngs.grad(g) * ngs.grad(s))
        ).Compile() * ngs.dx
        self._solver: Any = (
            SymmetricFactors(self._filter) if space.mesh.dim == 2 else PositiveSolver(self._filter)
        )
        self._shear_rate_load, self._pressure_load = ngs.LinearForm(space), ngs.LinearForm(space)
        cut_cells = ngs.dx(bonus_intorder=CUT_CELL_ORDER)
        self._shear_rate_load += (weight * shear_rate * s).Compile() * cut_cells
        self._pressure_load += (weight * pressure * s).Compile() * ngs.dx

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
        self._filter.Assemble()
        self._shear_rate_load.Assemble()
        self._pressure_load.Assemble()
        self._solver.update()
        self._solver.solve(self._shear_rate_load.vec, self.shear_rate.vec)
        self._solver.solve(self._pressure_load.vec, self.pressure.vec)
        shear_rate = self.shear_rate.vec.FV().NumPy()
        np.maximum(shear_rate, 0.0, out=shear_rate)
