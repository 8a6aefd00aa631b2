"""Ranks that sit out: they come and go without a trace in the result, and hear of errors."""

import json

from scaleup.system import crew

COMES_AND_GOES = """
import json
import sys

from scaleup.system import parallel

comm = parallel.start()
from scaleup.system import crew
from scaleup.run.blending import mix
from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.system.stopping import StoppedError

WANTED = json.loads(sys.argv[1])  # ranks, at one look after the other; the last for ever
crew._LOOK = crew._LEAST_STAY = 0.0
crew._DEAREST_CHANGE = float("inf")
looks = []


class Scripted(crew.Crew):
    def _wanted(self, ranks):
        looks.append(WANTED[min(len(looks), len(WANTED) - 1)])
        return ranks.bcast(looks[-1])  # the root has looked every time

    def muster(self):
        before = self.due
        super().muster()
        if before:
            sizes.append(self.size)


class Stopping:
    def asked(self, comm):
        return 15 if len(sizes) > 1 else 0


sizes = []
case = compose(
    None,
    ["grid.spacing='1.5 mm'", "operation.revolutions=0.15", "output.metrics_every=0.01"],
    {"flow": {"name": "surface-layer"}},
)
flow = obtain_flow(case, comm).flow
blend = mix(case, flow, comm, crew=Scripted(comm))
ends = 0
if len(set(sizes)) > 1:
    sizes, looks, came = [], [], sizes
    try:
        mix(case, flow, comm, crew=Scripted(comm), stopping=Stopping())
    except StoppedError as error:
        ends = error.exit_code
    sizes = came
if comm.rank == comm.size - 1:  # the one that sits out tells what it has got
    print(json.dumps([sizes, blend.intensity, blend.volumes, blend.ranks, ends]))
"""


def test_ranks_sit_out_and_come_back(on_ranks, store, monkeypatch):
    monkeypatch.delenv(crew.ALL_RANKS)
    alone = json.loads(on_ranks(1, COMES_AND_GOES, "[1]"))
    # each muster looks once, and so does each time that the crew is asked for a change
    sizes, *result, ends = json.loads(on_ranks(2, COMES_AND_GOES, "[1, 2, 2, 2, 1, 1, 2, 2]"))
    assert sizes == [1, 2, 1, 2]
    assert result[:2] == alone[1:3]
    assert result[2] == 2
    assert ends == 75


def test_clock_tells_idle_cores_from_busy_ones(tmp_path, monkeypatch):
    times = tmp_path / "stat"
    monkeypatch.setattr(crew, "_PROCESSOR_TIMES", times)
    # user nice system idle iowait irq softirq steal
    times.write_text("cpu 9 0 0 900 0\ncpu0 0 0 0 300 0\ncpu1 0 0 0 200 10\ncpu2 0 0 0 400 0\n")
    clock = crew._Clock({0, 1})
    clock._wall -= 2.0  # as if 2 s had gone by
    times.write_text("cpu 9 0 0 900 0\ncpu0 0 0 0 500 0\ncpu1 0 0 0 200 30\ncpu2 0 0 0 600 0\n")
    assert abs(clock.idle() - 1.1) < 0.05
