"""Two and more ranks: ghosts, balance, and the same concentrations as on one."""

import json

import h5py
import numpy as np
import pytest

GHOSTS = """
import sys
import numpy as np
from mpi4py import MPI
from scaleup.decomposition import Decomposition
from scaleup.grid import Grid

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

BLEND = """
import sys
import numpy as np
from scaleup import parallel
from scaleup.config import compose
comm = parallel.start()
from scaleup.blending import mix
from scaleup.flow_source import obtain_flow
from scaleup.results import Results

config = compose(None, ["grid.spacing='1 mm'", "operation.revolutions=0.15", *sys.argv[2:]],
                 {"flow": {"name": "surface-layer"}})
from pathlib import Path
outcome = obtain_flow(config, comm)
results = Results.of(Path(sys.argv[1]), outcome.flow)
blend = mix(config, outcome.flow, comm, results=results)
if comm.rank == 0:
    print(blend.intensity[-1], blend.ledger.steps, blend.ledger.clipped)
"""


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_ghosts_carry_their_owners_values_and_the_bed_is_shared_evenly(on_ranks, ranks):
    assert on_ranks(ranks, GHOSTS).strip() == "good"


@pytest.mark.parametrize(
    "options",
    [
        ["mixing.name=finite-volume"],
        ["mixing.name=lax-wendroff", "mixing.form=corrected"],
        ["mixing.name=lax-wendroff", "mixing.form=flux-corrected"],
        ["mixing.name=lax-wendroff", "mixing.form=paper", "diffusion.model=paper"],
        ["operation.loading.pattern=top-bottom", "operation.loading.shares=[0.3, 0.3, 0.4]"],
    ],
    ids=["finite-volume", "corrected", "flux-corrected", "paper", "three-components"],
)
def test_concentrations_are_the_same_on_one_two_and_three_ranks(store, on_ranks, tmp_path, options):
    fields = {}
    for ranks in (1, 2, 3):
        folder = tmp_path / str(ranks)
        folder.mkdir()
        on_ranks(ranks, BLEND, str(folder), *options)
        with h5py.File(folder / "results.h5", "r") as file:
            last = list(file["snapshots"].values())[-1]
            names = [name for name in last if name.startswith("concentration")]
            fields[ranks] = np.array([last[name] for name in sorted(names)])
    assert np.isfinite(fields[1]).sum() > 4000
    for ranks in (2, 3):
        assert np.nanmax(np.abs(fields[ranks] - fields[1])) < 1e-12


def test_an_error_on_one_rank_ends_all(on_ranks, tmp_path):
    program = (
        "from scaleup import parallel\ncomm = parallel.start()\n"
        "if comm.rank == 1:\n    raise RuntimeError('rank one fails')\n"
        "comm.Barrier()\n"
    )
    with pytest.raises(AssertionError, match="rank one fails"):
        on_ranks(2, program)


def test_the_root_works_while_others_sleep_and_its_error_reaches_all(on_ranks):
    program = (
        "import time\nfrom scaleup import parallel\nfrom scaleup.errors import RunError\n"
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
        "--revolutions", "1", "--set", "grid.spacing=1 mm", "--output", "run",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["timing"]["ranks"] == 2
    assert "I after   1 rev" in done.stdout
    assert not (tmp_path / "run.partial").exists()
