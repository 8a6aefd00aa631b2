"""A mixing backend to test the verification suite with: implicit upwind, of known order one."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from scaleup.contract import FloatArray, Interval, Ledger, Mixing, MixingScene, PluginOptions


class Upwind(Mixing):
    """Fluxes take the concentration upwind at the end of the step: any dimension, moving fill.

    Conservative, and bounded at any step, since the matrix is one of positive type; first order in
    space and time. No diffusion, one rank.
    """

    class Options(PluginOptions):
        pass

    halo = 1

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        self._flow = scene.flow
        grid = scene.flow.grid
        self._c = np.zeros((len(concentration), grid.cells))
        self._c[:, scene.flow.intervals[index].cells] = concentration
        self._solver: tuple[int, float, object] | None = None

    def stable_time_step(self, interval: Interval) -> float:
        """Any is stable; this one has a Courant number of about one half."""
        grid = self._flow.grid
        speed = max(
            float(np.abs(flux).max()) / grid.face_area(axis) / grid.spacing[axis]
            for axis, flux in enumerate(interval.flux)
        )
        return 0.5 / max(speed, 1.0)

    def advance(self, index: int, start: float, end: float) -> Ledger:
        part = self._flow.intervals[index]
        steps = int(np.ceil((end - start) / self.stable_time_step(part) - 1e-9))
        ledger, dt = (
            Ledger(steps=steps, cell_updates=steps * len(part.cells)),
            (end - start) / steps,
        )
        rate = (part.fill_end - part.fill_start) / part.duration
        for n in range(steps):
            before = part.fill_start + rate * (start + n * dt - part.start)
            after = before + rate * dt
            content = self._c[:, part.cells] * before
            self._c[:, part.cells] = self._solve(index, part, dt, after, content)
            ledger.minimum = min(ledger.minimum, float(self._c[:, part.cells].min()))
            ledger.maximum = max(ledger.maximum, float(self._c[:, part.cells].max()))
        return ledger

    def concentration(self, interval: Interval) -> FloatArray:
        return self._c[:, interval.cells]

    def _solve(self, index, part, dt, after, content):
        """The matrix V' + dt (outflow - inflow of neighbours), times c', is what there was."""
        steady = np.array_equal(part.fill_start, part.fill_end)
        if not (steady and self._solver and self._solver[:2] == (index, dt)):
            grid = self._flow.grid
            number = np.full(grid.cells, -1)
            number[part.cells] = np.arange(len(part.cells))
            number = number.reshape(grid.shape)
            rows, columns, values = [], [], []
            for axis, faces in enumerate(part.face_fluxes(grid)):
                along = grid.array_axis(axis)
                count = grid.shape[along]
                behind = np.take(number, range(count - 1), along).ravel()
                ahead = np.take(number, range(1, count), along).ravel()
                moved = dt * np.take(faces, range(1, count), along).ravel()
                for giver, taker, amount in ((behind, ahead, moved), (ahead, behind, -moved)):
                    given = amount > 0
                    rows += [giver[given], taker[given]]
                    columns += [giver[given], giver[given]]
                    values += [amount[given], -amount[given]]
            entries = (np.concatenate(rows), np.concatenate(columns))
            n = len(part.cells)
            matrix = coo_matrix((np.concatenate(values), entries), shape=(n, n))
            # a cell that is empty at the end and passes nothing on keeps its value
            held = np.maximum(after, 1e-12 * grid.cell_volume)
            self._solver = (index, dt, splu((matrix + diags(held)).tocsc()))
        return self._solver[2].solve(content.T).T
