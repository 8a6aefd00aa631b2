"""Loading patterns in three dimensions, and from files."""

import math

import h5py
import meshio
import numpy as np
import pytest

from scaleup.case.composing import compose
from scaleup.mixing.loading import initial_concentration
from scaleup.report.results import Results
from scaleup.scene.models import Loading
from scaleup.system import registry
from scaleup.system.errors import InputError
from synthetic import settled


@pytest.fixture(scope="module")
def bed():
    """A third of a V-blender: the level bed, and the coordinates and fills of its cells."""
    plugin = registry.load("geometry", "v-blender")
    vessel = plugin(plugin.Options())
    flow = settled(vessel, vessel.volume / 3, 0.006)
    cells = flow.intervals[0].cells
    return flow, flow.grid.centre_points(cells), flow.intervals[0].fill_start


@pytest.mark.parametrize(
    ("pattern", "axis", "first"),
    [("side-by-side", 0, -1), ("front-back", 2, 1), ("top-bottom", 1, 1)],
)
def test_layers_lie_where_their_names_say_and_have_their_shares(bed, pattern, axis, first):
    flow, points, fill = bed
    shares = (0.2, 0.5, 0.3)
    c = initial_concentration(Loading(pattern=pattern, shares=shares), flow)
    assert c.sum(axis=0) == pytest.approx(1.0, abs=1e-14)
    assert (c @ fill) / fill.sum() == pytest.approx(shares, rel=1e-12)
    middle = (c * fill) @ points[:, axis] / (c @ fill)
    assert np.all(np.diff(first * middle) < 0)  # the first component lies furthest there
    assert set(np.unique(c.round(12))) > {0.0, 1.0}
    others = [k for k in range(3) if k != axis]
    assert np.ptp(points[c[0] == 1][:, others], axis=0) == pytest.approx(
        np.ptp(points[:, others], axis=0), rel=0.5
    )


def test_layers_repeat_components_in_the_order_given(bed):
    flow, points, fill = bed
    sandwich = initial_concentration(Loading(pattern="layered"), flow)
    assert (sandwich @ fill) / fill.sum() == pytest.approx([2 / 3, 1 / 3], rel=1e-12)
    top, bottom = points[:, 1].max(), points[:, 1].min()
    assert np.all(sandwich[0][points[:, 1] > top - 0.01] == 1)
    assert np.all(sandwich[0][points[:, 1] < bottom + 0.01] == 1)
    loading = Loading(pattern="layered", along="z", shares=(0.1, 0.2, 0.3, 0.4), order=(2, 1, 3, 1))
    c = initial_concentration(loading, flow)
    assert (c @ fill) / fill.sum() == pytest.approx([0.6, 0.1, 0.3], rel=1e-12)
    assert c[1][points[:, 2].argmax()] == 1  # the front layer is component 2


def test_a_little_active_ingredient_at_a_place(bed):
    flow, points, fill = bed
    centre = (0.0, float(points[:, 1].min()) + 0.04, 0.0)
    c = initial_concentration(Loading(pattern="region", centre=centre, radius=0.02), flow)
    assert c[0] @ fill == pytest.approx(4 / 3 * math.pi * 0.02**3, rel=0.01)
    inside = np.linalg.norm(points - np.array(centre), axis=1) < 0.01
    assert np.all(c[0][inside] == 1)


def test_points_of_a_file_give_the_nearest_cells_their_concentrations(bed, tmp_path):
    flow, points, _ = bed
    wanted = 0.5 + 0.4 * np.sin(30 * points[:, 2])
    rows = np.column_stack([points, wanted])[np.random.default_rng(0).permutation(len(points))]
    np.savetxt(tmp_path / "c.csv", rows, delimiter=",", header="x,y,z,drug", comments="")
    cloud = meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])])
    cloud.point_data = {"concentration_1": wanted, "concentration_2": 1 - wanted}
    cloud.write(tmp_path / "c.vtu")
    results = Results.of(tmp_path, flow)
    results.create()
    interval = flow.intervals[0]
    for revolution, c in ((0.0, 0 * wanted), (1.0, wanted)):
        results.add(revolution, interval, 0.0, np.stack([c, 1 - c]))
    results.finish({"snapshots": [0.0, 1.0], "pictures": []})
    for name in ("c.csv", "c.vtu", "results.h5"):
        c = initial_concentration(Loading(pattern="file", file=tmp_path / name), flow)
        single = name == "results.h5"  # fields are kept in single precision
        assert c[0] == pytest.approx(wanted, abs=1e-7 if single else 1e-12), name
        assert c.sum(axis=0) == pytest.approx(1.0, abs=1e-15)
        assert c.sum(axis=0) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(
    ("assignments", "sentence"),
    [
        (["pattern=front-back"], "layers along z need a vessel in 3-D"),
        (["pattern=layered", "along=z"], "layers along z need a vessel in 3-D"),
        (["pattern=layered", "order=[1, 3]"], "every number from 1 to the greatest"),
        (["pattern=layered", "order=[1, 2]", "shares=[0.2, 0.3, 0.5]"], "each of the 3 shares"),
        (["pattern=top-bottom", "along=x"], "takes no along and no order"),
        (["pattern=file"], "the pattern 'file' needs file"),
        (["pattern=file", "file=gone.csv"], "path does not point to a file"),
        (["pattern=file", "file=HERE/head.csv"], "the first line names no column y"),
        (["pattern=file", "file=HERE/word.csv"], "cannot be read (could not convert string"),
        (["pattern=file", "file=HERE/above.csv"], "must lie between 0 and 1; they run from 0 to 3"),
        (["pattern=file", "file=HERE/sum.csv"], "must sum to 1; one sum is 0.8"),
        (["pattern=file", "file=HERE/empty.csv"], "the first line names no column x, y"),
        (["pattern=file", "file=HERE/none.csv"], "holds no concentrations"),
        (["pattern=file", "file=HERE/bad.h5"], "cannot be read"),
        (["pattern=file", "file=HERE/bad.vtu"], "cannot be read"),
    ],
)
def test_a_loading_that_cannot_be_is_one_sentence(tmp_path, assignments, sentence):
    files = {
        "head.csv": "x,a\n0,1\n", "word.csv": "x,y,a\n0,0,much\n",
        "above.csv": "x,y,a\n0,0,3\n1,1,0\n",
        "sum.csv": "x,y,a,b\n0,0,0.5,0.3\n", "empty.csv": "", "none.csv": "x,y\n0,0\n",
        "bad.h5": "text", "bad.vtu": "text",
    }  # fmt: skip
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    texts = [f"operation.loading.{a.replace('HERE', str(tmp_path))}" for a in assignments]
    with pytest.raises(InputError) as caught:
        compose(None, texts, {"flow": {"name": "surface-layer"}})
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_run_with_a_loading_file_is_reproduced_by_its_own_configuration(tmp_path):
    (tmp_path / "c.csv").write_text("x,y,a\n0,0,1\n0.01,0,0\n")
    texts = ["operation.loading.pattern=file", f"operation.loading.file={tmp_path / 'c.csv'}"]
    case = compose(None, texts, {"flow": {"name": "surface-layer"}})
    (tmp_path / "config.toml").write_text(case.to_toml())
    assert compose(tmp_path / "config.toml").operation == case.operation
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_group("snapshots")
    texts[1] = f"operation.loading.file={tmp_path / 'other.h5'}"
    with pytest.raises(InputError, match="cannot be read"):
        compose(None, texts, {"flow": {"name": "surface-layer"}})
