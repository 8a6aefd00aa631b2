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


VESSEL = """
import ngsolve as ngs
from scaleup import parallel
comm = parallel.start()
from vessel_in_space import drum_flow
flow = drum_flow(comm, tilt=30.0)
for _ in range(4):
    flow.step(0.01)
energy = ngs.Integrate(flow.velocity * flow.velocity, flow.mesh)
angle = flow.surface_angle()
if comm.rank == 0:
    print(repr(energy), repr(angle), flow.unknowns)
"""


def test_a_vessels_flow_is_the_same_on_one_two_and_three_ranks(on_ranks):
    """Two ranks hand the mesh to the second; three share it between the second and the third."""
    one, two, three = (
        [float(word) for word in on_ranks(ranks, VESSEL).split()] for ranks in (1, 2, 3)
    )
    assert one[0] > 1e-9
    for other in (two, three):
        assert other == pytest.approx(one, rel=2e-4)
