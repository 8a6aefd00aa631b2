"""Implicit finite-element transport of concentrations on the unknowns that a rank owns.

Algorithm of a step of dt from c (M = phi - mass, H the high-order fluxes' matrix of `operators`,
a_rs and t_s the Runge-Kutta scheme of `time_scheme`):

1. for each stage s: [M(t_s) + a_ss dt H] c_s = M c - dt sum_{r<s} a_sr H c_r;
2. the fluxes of the step are those of H from sum_s b_s c_s in dt, those of the mass from the gain
   in the step, and those of `filter`, in all G;
3. phi' c' = phi c - div G, kept within [0, 1] by `correction`.

Since c' follows from fluxes, mass is kept to round-off whatever the solver leaves. Steps are
`courant` times the largest at which the explicit upwind scheme is positive; none is too long.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags

from scaleup.contract import FloatArray, Interval, Ledger, MixingScene
from scaleup.numerics import BedTransport, ConservativeBed
from scaleup_implicit_fem import kernels
from scaleup_implicit_fem.correction import Correction
from scaleup_implicit_fem.filter import Filter
from scaleup_implicit_fem.operators import rows_of, times
from scaleup_implicit_fem.solver import LinearSolver
from scaleup_implicit_fem.time_scheme import DIAGONAL, STAGES, TIMES, WEIGHTS
from scaleup_implicit_fem.unknowns import Unknowns

if TYPE_CHECKING:
    from scaleup_implicit_fem import ImplicitFem

_SAME_STEP = 1e-9  # relative
_LOW_ORDER_TOLERANCE = 1e-14
_BLEND = 0.05  # measured: 0.1 costs a quarter more iterations, 0 diverges at 50 times the step


class Bed(ConservativeBed):
    """A bed that no step is too long for; cells are merged as for the explicit upwind scheme.

    explicit_step -- s, the limit of that scheme
    unknowns      -- after `settle`
    """

    def __init__(self, scene: MixingScene, interval: Interval):
        tensor = scene.tensor(interval)
        super().__init__(scene.flow.grid, scene.decomposition, interval, tensor)
        self._of_cells = tensor
        self.explicit_step, self.stable_step = self.stable_step, math.inf

    def settle(self, dt: float) -> None:
        """Form the groups and number the unknowns; collective, once per interval."""
        super().settle(min(dt, self.explicit_step))
        self.unknowns = Unknowns(self, self._of_cells)


class Transport(BedTransport[Bed]):
    """The algorithm above on the unknowns that a rank owns."""

    def __init__(
        self,
        scene: MixingScene,
        options: ImplicitFem.Options,
        concentration: FloatArray,
        index: int,
    ):
        self._options = options
        self._systems: dict[str, _System] = {}
        super().__init__(scene, options, concentration, index)

    def carry_over(self, before: Bed) -> None:
        """The field holds the values; what PETSc holds for the bed before goes."""
        before.unknowns.destroy()

    def make_bed(self, interval: Interval) -> Bed:
        """The bed with its unknowns."""
        return Bed(self.scene, interval)

    @property
    def own_step(self) -> float:
        """The limit of the explicit upwind scheme."""
        return self.bed.explicit_step

    def entered(self) -> None:
        """Rows of the matrices; sums and solvers follow with the first step."""
        unknowns = self.bed.unknowns
        pairs, own, size = unknowns.pairs, unknowns.count, unknowns.size
        self._ends = (pairs.first, pairs.second)
        self._correction = Correction(unknowns, self.moved, self.split.largest)
        self._high = rows_of(pairs, pairs.high, own, size)
        self._low = rows_of(pairs, pairs.low, own, size)
        self._mass = rows_of(pairs, np.stack([-pairs.mass, pairs.mass]), own, size)
        self._fluxes = np.zeros((self.moved, len(pairs.first)))
        self._forget()
        self._fills = self.split.largest(float(unknowns.fills)) > 0

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Steps of the algorithm above."""
        if self.bed.unknowns.total == 0:  # all is at rest
            return
        if abs(self._dt - dt) > _SAME_STEP * dt:
            self._forget()
            self._dt = dt
            self._filter = Filter(self.bed.unknowns, self._low.diagonal() * dt)
        self._iterations = 0
        c = self.bed.unknowns.read(self.field.flat)
        for n in range(count):
            c = self._step(c, start + n * dt)
        self.bed.unknowns.write(c, self.field.flat)
        self.field.exchange()
        ledger.iterations += self._iterations

    def _forget(self) -> None:
        """Drop what holds for one length of step; collective."""
        for system in self._systems.values():
            system.solver.destroy()
        self._dt, self._systems = 0.0, {}

    def _step(self, c: FloatArray, start: float) -> FloatArray:
        dt, unknowns, pairs = self._dt, self.bed.unknowns, self.bed.unknowns.pairs
        before, after = unknowns.fraction(start), unknowns.fraction(start + dt)
        own = slice(unknowns.count)
        held = (before * c)[:, own] + times(self._mass, c)
        rates: list[FloatArray] = []
        mean, stage = np.zeros_like(c), c
        for row, weight, time in zip(STAGES, WEIGHTS, TIMES, strict=True):
            right = held - dt * sum(a * rate for a, rate in zip(row, rates, strict=False))
            stage = self._solve("high", right, stage, start + time * dt)
            rates.append(times(self._high, stage))
            mean += weight * stage
        kernels.fluxes(self._fluxes, mean, dt * pairs.high, *self._ends)
        kernels.add_mass_fluxes(self._fluxes, stage - c, pairs.mass, *self._ends)
        self._fluxes += self._filter.fluxes(stage)
        low_order = partial(self._solve, "low", (before * c)[:, own], stage, start + dt)
        new = self._correction.apply(c, before, after, self._fluxes, low_order, dt)
        unknowns.exchange(new)
        return new

    def _solve(self, order: str, right: FloatArray, guess: FloatArray, time: float) -> FloatArray:
        """Solve the implicit equations of an order at a time (s) for all components; collective."""
        unknowns = self.bed.unknowns
        own, filled = unknowns.count, unknowns.fraction(time)[: unknowns.count]
        if order not in self._systems:
            self._systems[order] = self._system(order, filled)
        elif self._fills:
            self._systems[order].set_fill(filled)
        solver = self._systems[order].solver
        solution = np.empty((self.moved, unknowns.size))
        before = solver.iterations
        for k in range(self.moved):
            what = f"component {k + 1} ({order} order) at t = {time:.4g} s"
            solution[k, :own] = solver.solve(right[k], guess[k, :own], what)
        self._iterations += solver.iterations - before
        unknowns.exchange(solution)
        return solution

    def _system(self, order: str, filled: FloatArray) -> _System:
        low = self._dt * self._low
        if order == "high":
            rows = self._mass + DIAGONAL * self._dt * self._high
            # incomplete factors of a skew matrix may grow: a little of the low order mends that
            near = (1 - _BLEND) * rows + _BLEND * DIAGONAL * low
            tolerance = self._options.tolerance
        else:
            rows, near, tolerance = low, low, _LOW_ORDER_TOLERANCE
        fill = diags(filled, shape=rows.shape)
        solver = LinearSolver(
            self.bed.unknowns,
            csr_matrix(rows + fill),
            csr_matrix(near + fill),
            tolerance,
            self._options.petsc_options,
        )
        return _System(solver, rows.diagonal())


class _System:
    """The matrix of an order, and its diagonal apart from the fill."""

    def __init__(self, solver: LinearSolver, diagonal: FloatArray):
        self.solver, self._diagonal = solver, diagonal

    def set_fill(self, filled: FloatArray) -> None:
        """Put the fill fractions on the diagonal."""
        self.solver.set_diagonal(self._diagonal + filled)
