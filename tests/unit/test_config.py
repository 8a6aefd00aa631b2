import math

import pytest

from scaleup.case.composing import compose
from scaleup.system.errors import InputError

FAST = {"flow": {"name": "surface-layer"}}


def test_layers_compose_in_their_order(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(
        '[operation]\nspeed = "12 rpm"\nrevolutions = 5\n'
        "fill = { mass = 0.05 }\n[diffusion]\nk1 = 0.1\n",
        encoding="utf-8",
    )
    flags = {**FAST, "operation": {"revolutions": 2}}
    case = compose(file, ["diffusion.k1=0.2", "operation.revolutions=4"], flags)
    assert case.operation.speed == pytest.approx(12 * 2 * math.pi / 60)
    assert case.operation.fill.mass == 0.05
    assert case.operation.fill.depth_ratio is None  # one kind replaces the default kind
    assert case.diffusion.k1 == 0.2
    assert case.operation.revolutions == 2
    assert case.name("geometry") == "drum"  # the default
    assert case.config.grid.spacing == pytest.approx(3e-4)  # the geometry's default scene


def test_a_run_is_reproduced_by_its_own_file(tmp_path):
    case = compose(
        None,
        ["operation.loading.pattern=region", "operation.loading.centre=['-20 mm', '-50 mm']",
         "operation.loading.radius=5 mm", "geometry.diameter=0.2", "mixing.courant=0.5"],
        FAST,
    )  # fmt: skip
    file = tmp_path / "config.toml"
    file.write_text(case.to_toml(), encoding="utf-8")
    again = compose(file)
    assert again.to_toml() == case.to_toml()
    assert again.operation == case.operation
    assert again.options("geometry").diameter == 0.2


def test_another_plugin_drops_the_options_of_the_first(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text('[flow]\nname = "mohr-coulomb"\ntime_limit = 5\n', encoding="utf-8")
    case = compose(file, ["flow.closure=parabolic"], FAST)
    assert case.config.flow == {"name": "surface-layer", "closure": "parabolic"}


def test_a_loading_given_by_name_merges_with_its_details(tmp_path):
    shares = "operation.loading.shares=[0.3,0.7]"
    for order in (
        ["operation.loading=top-bottom", shares],
        [shares, "operation.loading=top-bottom"],
    ):
        loading = compose(None, order, FAST).operation.loading
        assert (loading.pattern, loading.shares) == ("top-bottom", (0.3, 0.7))
    file = tmp_path / "run.toml"
    file.write_text('[operation]\nloading = "top-bottom"\n', encoding="utf-8")
    assert compose(file, [shares], FAST).operation.loading.pattern == "top-bottom"


def test_fill_in_every_kind_is_the_same_bed():
    base = compose(None, [], FAST)
    kinds = base.fill_in_all_kinds
    assert kinds["depth_ratio"] == pytest.approx(0.35, abs=1e-12)
    for kind, value in kinds.items():
        case = compose(None, [f"operation.fill.{kind}={value!r}"], FAST)
        assert case.fill_volume == pytest.approx(base.fill_volume, rel=1e-9)


def test_cells_choose_the_spacing():
    case = compose(None, ["grid.cells=40000"], FAST)
    area = case.fill_volume / 0.01
    assert area / case.spacing**2 == pytest.approx(40000)


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        ("operation.sped=1", "operation.sped = 1: unknown key; did you mean 'speed'?"),
        ("material.friction_angle='100 deg'", "material.friction_angle = '100 deg'"),
        ("operation.speed='6 mm'", "operation.speed = '6 mm': wrong unit mm"),
        ("operation.fill.depth_ratio=1.2", "operation.fill.depth_ratio = 1.2"),
        ("operation.fill.mass=5", "operation.fill.mass = 5 kg: the vessel holds 0.2309 kg"),
        ("geometry.diameter='-1 mm'", "geometry.diameter = '-1 mm': must be at least 0.001 um"),
        ("geometry.colour=red", "unknown key; known here: size, diameter"),
        ("mixing.courant=2", "mixing.courant = 2"),
        ("flow.name=magic", "flow.name = 'magic': no such flow; installed are: mohr-coulomb"),
        ("operation.loading=diagonal", "operation.loading.pattern = 'diagonal'"),
        ("operation.loading.radius='1 mm'", "takes no centre and no radius"),
        ("operation.speed='2000 rpm'", "Froude number"),
        ("output.metrics_every=1e-12", "output.metrics_every = 1e-12"),
        ("grid.spacing='1 um'", "more than 2e+09"),
        ("grid.spacing=banana", "grid.spacing = 'banana': not a quantity"),
        ("k1=3", "--set 'k1=3': write it as section.key=value"),
        ("material.bulk_density=3000", "must be below grain_density"),
    ],
)
def test_bad_input_is_one_sentence_naming_key_value_and_rule(assignment, sentence):
    with pytest.raises(InputError) as caught:
        compose(None, [assignment])
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
