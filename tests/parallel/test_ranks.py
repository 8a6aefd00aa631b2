"""Two and more ranks: ghosts, balance, and the same concentrations as on one."""

import json

import h5py
import numpy as np
import pytest

GHOSTS = """
import sys
import numpy as np
from mpi4py import MPI
from scaleup.space.decomposition import Decomposition
from scaleup.space.grid import Grid

comm = MPI.COMM_WORLD
grid = Grid((0.0, 0.0), (1.0, 1.0), (40, 30))
x, y = np.meshgrid(np.arange(40), np.arange(30))
bed = np.flatnonzero(((x - 20) ** 2 + (y - 8) ** 2 < 60) & (y > 2))
for halo in (1, 2):
    split = Decomposition(grid, bed, comm, halo=halo)
    keep, where = split.owned_cells(bed)
    counts = comm.allgather(int(keep.sum()))
    assert sum(counts) == len(bed)
    assert max(counts) < 1.4 * len(bed) / comm.size, counts
    field = split.field(components=2)
    field.array[...] = -1.0
    field.array[:, *where] = np.stack([bed[keep] + 0.5, bed[keep] + 0.25])
    field.exchange()
    seen = split.to_local(bed, np.stack([bed + 0.5, bed + 0.25]), empty=-1.0)
    inside = split.to_local(bed, np.ones(len(bed)))
    assert np.array_equal(field.array[:, inside > 0], seen[:, inside > 0])
    gathered = split.gather(bed, (bed[keep] + 0.5)[None, :], keep)
    assert np.array_equal(gathered[0], bed + 0.5)
    assert split.total(1.0) == comm.size and split.largest(comm.rank) == comm.size - 1
print("good" if comm.rank == 0 else "", end="")
"""

BLENDS = """
import json
import sys
from pathlib import Path

import dataclasses
import numpy as np
from scaleup.system import parallel

comm = parallel.start()
from scaleup.run.blending import mix
from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.report.results import Results
from scaleup.verification import problems, run
from scaleup.verification.problem import uniform_diffusion
from scaleup.contract import Drift
from scaleup_finite_volume import FiniteVolume
from scaleup_semi_lagrangian import SemiLagrangian

for name, options in json.loads(sys.argv[2]).items():
    settings = ["grid.spacing='1.5 mm'", "operation.revolutions=0.15", *options]
    case = compose(None, settings, {"flow": {"name": "surface-layer"}})
    flow = obtain_flow(case, comm).flow
    folder = Path(sys.argv[1]) / name
    if comm.rank == 0:
        folder.mkdir()
    comm.Barrier()
    blend = mix(case, flow, comm, results=Results.of(folder, flow))

if comm.size < 3:  # in space, on a moving fill
    tensor = 1e-3 * np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.3], [0.0, 0.3, 1.0]])
    problem = dataclasses.replace(problems()["sloshing-3d"], laws=(uniform_diffusion(tensor),))
    def sinking(flow, interval, time):
        down = np.repeat(flow.down(time)[:, None], len(interval.cells), axis=1)
        return 0.1 * np.stack([down, 0.0 * down])

    drifting = dataclasses.replace(problem, laws=(*problem.laws, Drift(sinking)))
    for problem, plugin in ((problem, SemiLagrangian), (drifting, FiniteVolume)):
        result = run(problem, plugin(plugin.Options()), 16, comm)
        if comm.rank == 0:
            print(result.mass_drift, result.minimum, result.maximum, result.l1)
"""


SHARED = """
import dataclasses
import sys
from pathlib import Path

import numpy as np

from scaleup.system import parallel

comm = parallel.start()
from scaleup.space.compact_intervals import CompactInterval, CompactIntervals
from scaleup.system.errors import ContractError, RunError
from scaleup.flow.check import check_flow, check_shared_flow
from scaleup.flow.storage import read_flow, write_flow
from synthetic import sloshing

whole = sloshing(prefix=2)
volume = float(whole.intervals[0].fill_start.sum())
parts = [CompactInterval.of(part) for part in whole.intervals]
edges = np.linspace(0, len(parts), comm.size + 1).astype(int)


def shared(parts, first, stop):
    held = CompactIntervals(parts[first:stop], whole.times, None, first)
    return dataclasses.replace(whole, intervals=held)


def refused(flow, says):
    try:
        check_shared_flow(flow, None, None, comm)
    except ContractError as error:
        assert says in str(error), str(error)
    else:
        raise AssertionError(f"accepted: {says}")


first, stop = edges[comm.rank], edges[comm.rank + 1]
own = shared(parts, first, stop)
check_shared_flow(own, None, volume, comm)
write_flow(Path(sys.argv[1]), own, comm)
check_flow(read_flow(Path(sys.argv[1])), fill_volume=volume)

def lowered(part):
    less = 0.01 * whole.grid.cell_volume * (np.arange(len(part.cells)) == 20)
    start, end = part.fill_start - less, part.fill_end - less
    return dataclasses.replace(part, fill_start=start, fill_end=end)


jump = [lowered(part) if n >= edges[-2] else part for n, part in enumerate(parts)]
refused(shared(jump, first, stop), "jumps")  # where the last two ranks join
refused(shared(parts, first, stop - (comm.rank == comm.size - 1)), "held by no rank")
open_ended = shared(parts[:-1], first, min(stop, len(parts) - 1))
open_ended.intervals._times = whole.times[:-1]
refused(open_ended, "the periodic part")  # whose ends lie on the last and on the first rank


def fail():
    if comm.rank == 1:
        raise RunError("rank one cannot")


try:
    parallel.on_each(comm, fail)
except RunError:
    count = comm.allreduce(1)
    print(count if comm.rank == 0 else "", end="")
"""

GENERAL = """
import sys
from pathlib import Path

from scaleup.system import parallel

comm = parallel.start()
from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow

case = compose(None, ["flow.model=general", "flow.intervals=24", "grid.spacing='6 mm'"],
                 {"geometry": {"name": "v-blender"}, "flow": {"name": "surface-layer"}})
outcome = obtain_flow(case, comm)
assert len(outcome.flow.intervals) - outcome.flow.prefix == 24
assert 100 < len(outcome.flow.intervals[30].cells)
"""


@pytest.mark.parametrize("ranks", [2, 3])
def test_a_flow_shared_out_is_checked_where_ranks_join_and_stored_whole(on_ranks, ranks, tmp_path):
    assert on_ranks(ranks, SHARED, str(tmp_path / "flow.h5")).strip() == str(ranks)


def test_the_surface_layer_is_the_same_on_one_and_on_three_ranks(on_ranks, tmp_path, monkeypatch):
    flows, summaries = [], []
    for ranks in (1, 3):
        monkeypatch.setenv("SCALEUP_CACHE", str(tmp_path / str(ranks)))
        on_ranks(ranks, GENERAL)
        (path,) = (tmp_path / str(ranks)).glob("flow-*.h5")
        with h5py.File(path, "r") as file:
            flows.append({name: data[...] for name, data in file["intervals"].items()})
            summaries.append(json.loads(file.attrs["summary"]))
    one, three = flows
    for name in ("volume_stuck", "volume_detoured", "surface_shift", "bed_lean_deg"):
        assert summaries[0][name] == pytest.approx(summaries[1][name], rel=1e-12), name
    for name in ("first", "first_run", "cells", "still"):
        assert np.array_equal(one[name], three[name]), name
    for name in ("fill_start", "fill_end", "flux", "shear_rate"):
        assert np.abs(one[name] - three[name]).max() <= 1e-12 * np.abs(one[name]).max(), name


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_ghosts_carry_their_owners_values_and_the_bed_is_shared_evenly(on_ranks, ranks):
    assert on_ranks(ranks, GHOSTS).strip() == "good"


MIXINGS = {
    "finite-volume": ["mixing.name=finite-volume"],
    "corrected": ["mixing.name=lax-wendroff", "mixing.form=corrected"],
    "flux-corrected": ["mixing.name=lax-wendroff", "mixing.form=flux-corrected"],
    "paper": ["mixing.name=lax-wendroff", "mixing.form=paper", "diffusion.model=paper"],
    "semi-lagrangian": ["mixing.name=semi-lagrangian"],
    "three-components": [
        "operation.loading.pattern=top-bottom",
        "operation.loading.shares=[0.3, 0.3, 0.4]",
    ],
}


@pytest.fixture(scope="module")
def blended(store, on_ranks, tmp_path_factory):
    """By number of ranks: the folder of its blends, and what was found in space."""
    found = {}
    for ranks in (1, 2, 3):
        folder = tmp_path_factory.mktemp("blends")
        printed = on_ranks(ranks, BLENDS, str(folder), json.dumps(MIXINGS))
        found[ranks] = folder, np.array(printed.split(), dtype=float)
    return found


@pytest.mark.parametrize("mixing", MIXINGS)
def test_concentrations_are_the_same_on_one_two_and_three_ranks(blended, mixing):
    fields = {}
    for ranks, (folder, _) in blended.items():
        with h5py.File(folder / mixing / "results.h5", "r") as file:
            last = list(file["snapshots"].values())[-1]
            names = [name for name in last if name.startswith("concentration")]
            fields[ranks] = np.array([last[name] for name in sorted(names)])
    assert np.isfinite(fields[1]).sum() > 4000
    assert 0.1 < np.nanstd(fields[1]) < 0.6
    for ranks in (2, 3):
        assert np.nanmax(np.abs(fields[ranks] - fields[1])) < 1e-12


def test_long_steps_and_a_drift_agree_on_ranks_in_space_on_a_moving_fill(blended):
    """`semi-lagrangian` with diffusion; `finite-volume` with a drift too."""
    (_, one), (_, two) = blended[1], blended[2]
    assert np.abs(one - two).max() < 1e-12
    for mass_drift, least, greatest, away in one.reshape(2, 4):
        assert abs(mass_drift) < 1e-12
        assert least > -1e-12
        assert greatest < 1 + 1e-12
        assert away > 1e-3


def test_an_error_on_one_rank_ends_all(on_ranks, tmp_path):
    program = (
        "from scaleup.system import parallel\ncomm = parallel.start()\n"
        "if comm.rank == 1:\n    raise RuntimeError('rank one fails')\n"
        "comm.Barrier()\n"
    )
    with pytest.raises(AssertionError, match="rank one fails"):
        on_ranks(2, program)


def test_the_root_works_while_others_sleep_and_its_error_reaches_all(on_ranks):
    program = (
        "import time\nfrom scaleup.system import parallel\n"
        "from scaleup.system.errors import RunError\n"
        "comm = parallel.start()\n"
        "assert parallel.on_root(comm, lambda: comm.rank + 41) == 41\n"
        "def fail():\n    time.sleep(0.2)\n    raise RunError('no')\n"
        "try:\n    parallel.on_root(comm, fail)\nexcept RunError:\n"
        "    count = comm.allreduce(1)\n    print(count if comm.rank == 0 else '', end='')\n"
    )
    assert on_ranks(2, program).strip() == "2"


def test_simulate_on_two_ranks_writes_a_whole_run(scaleup, tmp_path):
    done = scaleup(
        "simulate", "--geometry", "drum", "--flow", "surface-layer", "--ranks", "2",
        "--revolutions", "1", "--set", "grid.spacing=2 mm", "--output", "run",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["timing"]["ranks"] == 2
    assert "I after   1 rev" in done.stdout
    assert not (tmp_path / "run.partial").exists()
