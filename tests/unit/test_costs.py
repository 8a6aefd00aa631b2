"""What a run will cost, scaled from what runs have cost."""

import dataclasses

import pytest

from scaleup.flow.storage import Store
from scaleup.run.costs import Cost, estimate, known, record

BASE = Cost("tote", "layer", "volumes", 3, 1000, 1, 2.0, 100, 8.0, 4.0, 1e9)
WANTED = {"geometry": "tote", "flow": "layer", "mixing": "volumes", "dimension": 3}


def run(**change):
    return dataclasses.replace(BASE, **change)


def test_one_run_is_scaled_by_the_stable_step():
    found = estimate([BASE], **WANTED, cells=8000, ranks=2, revolutions=6.0)
    assert found.steps == pytest.approx(100 / 2 * 6 * 2)
    assert found.mixing_s == pytest.approx(4.0 / 2 * 6 * 8 ** (4 / 3) / 2)
    assert found.flow_s == pytest.approx(8 * 8.0)  # as the cells
    assert found.memory == pytest.approx(0.25e9 + 8 * 0.75e9)


def test_powers_and_memory_are_fitted_to_runs_that_are_apart():
    runs = [BASE, run(cells=16000, mixing_s=4.0 * 16, flow_s=8.0 * 4, memory=2.5e9)]
    found = estimate(runs, **WANTED, cells=64000, ranks=1, revolutions=2.0)
    assert found.mixing_s == pytest.approx(4.0 * 64)  # linear, less than the stable step asks
    assert found.flow_s == pytest.approx(8.0 * 8)  # the square root
    assert found.memory == pytest.approx(2.5e9 + 48000 * 1e5)
    steep = [BASE, run(cells=16000, mixing_s=4.0 * 16**2)]  # noise: no scheme is that steep
    found = estimate(steep, **WANTED, cells=128000, ranks=1, revolutions=2.0)
    assert found.mixing_s == pytest.approx(4.0 * 16**2 * 8 ** (4 / 3))


def test_runs_of_the_same_vessel_come_first_and_others_will_do():
    other = run(geometry="drum", mixing_s=40.0)
    assert estimate([other, BASE], **WANTED, cells=1000, ranks=1, revolutions=2.0).basis == [BASE]
    found = estimate([other], **WANTED, cells=1000, ranks=1, revolutions=2.0)
    assert found.mixing_s == pytest.approx(40.0)
    for change in ({"flow": "x"}, {"mixing": "x"}, {"dimension": 2}):
        assert estimate([run(**change)], **WANTED, cells=1000, ranks=1, revolutions=2.0) is None
    reused = estimate([run(flow_s=None)], **WANTED, cells=1000, ranks=1, revolutions=2.0)
    assert reused.flow_s is None


def test_records_come_back_and_strange_lines_do_not_matter(tmp_path):
    store = Store(tmp_path)
    assert known(store) == []
    record(BASE, store)
    with (tmp_path / "costs.jsonl").open("a") as stream:
        stream.write('{"half": \n{"cells": 3}\n')
    record(run(cells=5), store)
    assert known(store) == [BASE, run(cells=5)]
