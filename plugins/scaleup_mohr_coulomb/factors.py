"""Repeated factorisation of a matrix whose pattern stays the same."""

from __future__ import annotations

from typing import Any


class SymmetricFactors:
    """L D L^T of a symmetric form's matrix; the order of elimination is found once."""

    def __init__(self, form: Any) -> None:
        self._form = form
        self.inverse: Any = None

    def update(self) -> None:
        """Factorise the matrix as it stands."""
        if self.inverse is None:
            self.inverse = self._form.mat.Inverse(inverse="sparsecholesky")
        else:
            self.inverse.Update()
