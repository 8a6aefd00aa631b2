"""What is done with the states of a blend: each observer alone, on a schedule of its own."""

from types import SimpleNamespace

import numpy as np
import pytest

from scaleup.flow import storage
from scaleup.measure.blend import Blend
from scaleup.mixing.march import State, march
from scaleup.run.observers import Checkpoint, Curve, Moment, Pictures, Progress, Snapshots
from scaleup.run.plan import Plan
from synthetic import sloshing

PLAN = Plan(
    points=(0.0, 0.1, 0.25, 0.4),
    curve=frozenset({0.0, 0.1, 0.4}),
    snapshots=frozenset({0.0, 0.4}),
    pictures=frozenset({0.25}),
    final=0.25,
)


@pytest.fixture(scope="module")
def flow():
    return sloshing(prefix=0)


@pytest.fixture
def state(flow):
    x = flow.grid.centre_points(flow.intervals[0].cells)[:, 0]
    left = (x < x.mean()).astype(float)
    return State(np.stack([left, 1.0 - left]))


def moment(state, number, stop=0):
    return Moment(state, number, PLAN.points[number], stop)


def paused(state):
    return State(state.concentration, paused=15)


def due(observer, state):
    return [number for number in range(4) if observer.due(moment(state, number))]


class Recorder:
    """Stands for the fields of a run."""

    def __init__(self):
        self.calls = []

    def add(self, revolution, interval, time, concentration):
        self.calls.append(("snapshot", revolution))

    def add_picture(self, revolution, interval, time, concentration):
        self.calls.append(("picture", revolution))


def test_each_observer_keeps_to_its_schedule(flow, state, tmp_path):
    blend, fields = Blend(), Recorder()
    curve = Curve(PLAN, blend, flow, 0.02)
    pictures, snapshots = Pictures(PLAN, flow, fields), Snapshots(PLAN, blend, flow, fields)
    assert due(curve, state) == [0, 1, 3]
    assert due(pictures, state) == [2]
    assert due(snapshots, state) == [0, 3]
    for observer in (curve, pictures, snapshots):  # between two points nothing is measured or drawn
        assert not observer.due(moment(paused(state), 0))
    pictures.observe(moment(state, 2))
    snapshots.observe(moment(state, 3))
    assert fields.calls == [("picture", 0.25), ("snapshot", 0.4)]


def test_the_curve_measures_what_is_there(flow, state):
    blend = Blend()
    curve = Curve(PLAN, blend, flow, 0.02)
    curve.observe(moment(state, 0))
    even = State(np.full_like(state.concentration, 0.5))
    curve.observe(moment(even, 1))
    assert blend.revolutions == [0.0, 0.1]
    assert blend.intensity == pytest.approx([1.0, 0.0], abs=0.02)
    assert blend.rsd[0] > 0.5
    assert blend.rsd[1] == pytest.approx(0.0, abs=1e-12)
    assert sum(blend.volumes[0]) == pytest.approx(flow.intervals[0].fill_start.sum(), rel=1e-14)


def test_progress_says_how_far_the_run_is(state):
    said = []
    progress = Progress(PLAN, Blend(intensity=[0.5]), lambda *words: said.append(words))
    for number in range(4):
        progress.observe(moment(state, number))
    assert [share for share, _ in said] == [0.25, 0.5, 0.75, 1.0]
    assert said[1][1] == "revolution 0.10, I = 0.500"


def test_a_checkpoint_is_kept_where_a_run_goes_on_from_and_where_it_is_asked_to_end(
    state, tmp_path
):
    path, blend = tmp_path / "checkpoint.h5", Blend()
    seldom = Checkpoint(path, PLAN, blend, {"code": "x"}, every=1e9, with_fields=True)
    assert due(seldom, state) == [2]  # the point from which a longer run goes on
    assert seldom.due(moment(paused(state), 1, stop=15))
    assert not seldom.due(moment(state, 3, stop=15))  # no run goes on from beyond it
    often = Checkpoint(path, PLAN, blend, {"code": "x"}, every=0.0, with_fields=False)
    assert due(often, state) == [0, 1, 2]
    seldom.observe(moment(state, 2))
    arrays, kept = storage.read_checkpoint(path)
    assert np.array_equal(arrays["concentration"], state.concentration)
    assert kept["revolution"] == 0.25
    assert kept["instants"] == {"snapshots": [0.0], "pictures": [0.25]}


def test_a_march_yields_every_asked_time_and_lands_where_it_is_told(flow, state):
    """Also where two asked times are one, and from a state that it has yielded before."""
    visited = []

    def advance(index, start, end):
        visited.append((index, start, end))
        return Blend().ledger

    backend = SimpleNamespace(
        advance=advance, concentration=lambda interval, time: state.concentration
    )
    period = flow.period
    times = [0.0, 0.0, 0.3 * period, period]
    states = list(march(flow, backend, times, state, landings=[0.1 * period]))
    assert [each.clock for each in states] == times
    ends = [end for _, _, end in visited]
    assert any(end == pytest.approx(0.1 * period) for end in ends)
    assert sum(end - start for _, start, end in visited) == pytest.approx(period)
    visited.clear()
    (last,) = march(flow, backend, times[3:], states[2])
    assert (last.index, last.local) == pytest.approx((states[3].index, states[3].local))
    assert sum(end - start for _, start, end in visited) == pytest.approx(0.7 * period)
    asked = iter([0, 10, 0, 0, 0, 0, 0, 0])
    first = next(march(flow, backend, [period], state, pause=lambda: next(asked)))
    assert (first.paused, first.clock < period) == (10, True)
