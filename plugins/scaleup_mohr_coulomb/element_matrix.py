"""Sparse matrices that are sums of small dense blocks, one for each element of a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .shared_matrix import Share


class ElementMatrix:
    """Sum of ``blocks`` (n_elements, k, k) over the unknowns of each element.

    ``numbers`` (n_elements, k) are the unknowns' local numbers, of ``count``.
    """

    def __init__(self, numbers: NDArray[Any], count: int) -> None:
        self.blocks = np.zeros((*numbers.shape, numbers.shape[1]))
        rows = np.broadcast_to(numbers[:, :, None], self.blocks.shape).ravel()
        columns = np.broadcast_to(numbers[:, None, :], self.blocks.shape).ravel()
        entries, self._entry = np.unique(
            rows.astype(np.int64) * count + columns, return_inverse=True
        )
        self._columns = entries % count
        in_row = np.bincount(entries // count, minlength=count)
        self._starts = np.concatenate([[0], np.cumsum(in_row)])

    def share(self) -> Share:
        """What this rank's elements add to the matrix."""
        values = np.bincount(self._entry, self.blocks.ravel(), len(self._columns))
        return values, self._columns, self._starts
