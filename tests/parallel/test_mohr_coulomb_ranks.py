"""Finite elements in space on ranks: the same flow to the linear solver's tolerance."""

import pytest

BAGNOLD = """
from scaleup import parallel
comm = parallel.start()
from bagnold import bagnold_error
error = bagnold_error(3, 3, comm=comm)
if comm.rank == 0:
    print(repr(error))
"""


def test_bagnold_flow_in_space_is_the_same_on_two_ranks(on_ranks):
    one, two = (float(on_ranks(ranks, BAGNOLD)) for ranks in (1, 2))
    assert one < 0.005
    assert two == pytest.approx(one, rel=1e-6)
