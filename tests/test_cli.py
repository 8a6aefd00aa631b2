"""The command line as a user meets it: whole runs, and bad input."""

import json

import pytest

from scaleup.case.composing import compose
from scaleup.flow.source import stored_flow

QUICK = ("--flow", "surface-layer", "--set", "grid.spacing=2 mm", "--revolutions", "0.5")
KEYS = {
    "schema": None,
    "model": {"dimension", "frame", "flow", "mixing", "reasons"},
    "flow": {
        "surface_angle_deg", "surface_speed_max", "active_layer_thickness", "solid_body_ratio",
        "flux_midbed", "volume_drift",
    },
    "mixing": {"revolutions", "segregation_intensity", "lacey", "rsd", "blend_time_revolutions"},
    "ledger": {"mass_drift", "minimum", "maximum", "clipped_mass"},
    "error_estimate": {"segregation_intensity"},
    "timing": {"flow_s", "mixing_s", "total_s", "ranks", "cell_updates_per_s"},
    "machine": {"processor", "cores"},
    "versions": {"scaleup", "numpy", "mpi4py", "petsc4py", "ngsolve", "h5py"},
}  # fmt: skip


def test_a_run_folder_is_complete_and_its_report_has_every_key(scaleup, tmp_path):
    told = ("--set", "material.provenance.friction_angle='a shear test'")
    done = scaleup("simulate", *QUICK, *told, "--output", "run")
    assert done.returncode == 0, done.stderr
    run = tmp_path / "run"
    for name in ("config.toml", "results.h5", "results.xdmf", "report.json", "report.html",
                 "checkpoint.h5", "run.log", "figures/snapshots.png", "figures/blend_curve.png",
                 "figures/speed.png", "figures/velocity_profiles.png"):  # fmt: skip
        assert (run / name).stat().st_size > 0, name
    report = json.loads((run / "report.json").read_text())
    for section, keys in KEYS.items():
        assert section in report
        if keys:
            assert keys <= set(report[section]), section
    missing = [
        f"{section}.{key}"
        for section, values in report.items()
        if isinstance(values, dict)
        for key, value in values.items()
        if value is None and f"{key}_reason" not in values
    ]
    assert missing == []
    mixing = report["mixing"]
    assert mixing["segregation_intensity"][0] > 0.9
    assert mixing["revolutions"][-1] == 0.5
    assert report["operation"]["froude_number"] == pytest.approx(0.6283185**2 * 0.07 / 9.8)
    assert len(report["mixing"]["centre_line"]) == 2
    assert report["material"]["provenance"] == {"friction_angle": "a shear test"}
    page = (run / "report.html").read_text()
    assert "<img" in page
    assert "a shear test" in page

    # the same flow, another diffusion constant: reused, and said
    again = scaleup("simulate", *QUICK, "--set", "diffusion.k1=0.1", "--output", "again")
    assert "flow: reused from the store" in again.stderr
    other = json.loads((tmp_path / "again" / "report.json").read_text())
    assert other["flow"]["reused"] is True
    assert other["timing"]["flow_s"] == 0.0
    assert other["mixing"]["segregation_intensity"][-1] < mixing["segregation_intensity"][-1]

    # its own configuration reproduces the run
    repeat = scaleup("simulate", "run/config.toml", "--output", "repeat")
    assert repeat.returncode == 0, repeat.stderr
    same = json.loads((tmp_path / "repeat" / "report.json").read_text())
    assert same["mixing"] == mixing


def test_an_existing_run_is_kept_unless_told(scaleup, tmp_path):
    scaleup("simulate", *QUICK, "--output", "run")
    before = (tmp_path / "run" / "report.json").read_bytes()
    refused = scaleup("simulate", *QUICK, "--output", "run")
    assert refused.returncode == 2
    assert "--overwrite" in refused.stderr
    assert (tmp_path / "run" / "report.json").read_bytes() == before
    done = scaleup("simulate", *QUICK, "--output", "run", "--overwrite")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "report.json").read_bytes() != before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    refused = scaleup("simulate", *QUICK, "--output", "mine", "--overwrite")
    assert refused.returncode == 2
    assert (tmp_path / "mine" / "thesis.txt").exists()
    (tmp_path / "new.partial").mkdir()
    (tmp_path / "new.partial" / "thesis.txt").write_text("precious")
    refused = scaleup("simulate", *QUICK, "--output", "new", "--overwrite")
    assert refused.returncode == 2
    assert (tmp_path / "new.partial" / "thesis.txt").exists()
    (tmp_path / ".run.old").mkdir()  # left by a run that was killed while it was put in place
    (tmp_path / ".run.old" / "report.json").write_text("{}")
    done = scaleup("simulate", *QUICK, "--output", "run", "--overwrite")
    assert done.returncode == 0, done.stderr


def test_a_failed_error_estimate_does_not_lose_the_run(scaleup, tmp_path):
    done = scaleup(
        "simulate", "--flow", "surface-layer", "--mixing", "lax-wendroff", "--set",
        "mixing.form=paper", "--set", "grid.spacing=12 mm", "--revolutions", "0.1",
        "--set", "accuracy.scrutiny=12", "--output", "run",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["error_estimate"]["segregation_intensity"] is None
    assert "twice as large" in report["error_estimate"]["segregation_intensity_reason"]
    assert any("cells thick" in sentence for sentence in report["warnings"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--set", "operation.sped=1"], "operation.sped = 1: unknown key"),
        (["--geometry", "cement-mixer"], "geometry.name = 'cement-mixer': no such geometry"),
        (["--mixing", "spoon"], "mixing.name = 'spoon': no such mixing; installed are: finite-v"),
        (["--set", "geometry.diameter=-1 mm"], "geometry.diameter = '-1 mm'"),
        (["--set", "operation.fill.depth_ratio=1.2"], "operation.fill.depth_ratio = 1.2"),
        (["--set", "operation.speed=6 mm"], "operation.speed = '6 mm': wrong unit"),
        (["--ranks", "0"], "--ranks = 0: must be 1 or more"),
        (["--ranks", "two"], "Invalid value for '--ranks': 'two' is not a valid integer"),
        (["--revolutions", "many"], "--revolutions = 'many': must be a number"),
        (["missing.toml"], "the configuration missing.toml cannot be read: No such file"),
        (["broken.toml"], "the configuration broken.toml is not TOML"),
        (["--colour", "red"], "No such option"),
        (
            ["--geometry", "tote", "--set", "geometry.axis_height=5 m"],
            "geometry.name = 'tote': the axis of rotation misses the vessel",
        ),
        (
            ["--geometry", "v-blender", "--set", "operation.fill.mass=1 t"],
            "operation.fill.mass = 1000 kg: the vessel holds 11.6 kg",
        ),
        (
            ["--geometry", "tote", "--flow", "mohr-coulomb", "--set", "flow.start_up=true"],
            "flow.start_up = True: belongs to the form 'plane' (2-D, a drum's cross-section",
        ),
        (
            ["--geometry", "drum", "--set", "geometry.diameter=50 m"],
            "reaches 25 m from its axis and holds 1.96e+04 litres, but must reach 5 mm to 20 m",
        ),
        (
            [
                "--set",
                "operation.loading.pattern=region",
                "--set",
                "operation.loading.radius=1 mm",
                "--set",
                "operation.loading.centre=['0 m']",
            ],
            "needs 2 coordinates",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_sentence_and_writes_nothing(refused, tmp_path, arguments, sentence):
    (tmp_path / "broken.toml").write_text("[geometry\n")
    assert sentence in refused("simulate", *arguments, "--output", "run")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.toml"]


def test_plugins_are_listed_and_shown(scaleup, refused):
    listed = scaleup("plugins", "list")
    for name in ("drum", "mohr-coulomb", "surface-layer", "lax-wendroff"):
        assert name in listed.stdout
    shown = scaleup("plugins", "show", "mohr-coulomb").stdout
    assert "element size" in shown
    keys = ("flow.fine_size", "flow.start_up", "flow.intervals")
    for key, part in zip(keys, shown.split("options of the form "), strict=True):
        assert key in part
    assert "installed are: drum" in refused("plugins", "show", "nothing")


def test_doctor_finds_everything_and_two_ranks_greet(scaleup):
    done = scaleup("doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAIL" not in done.stdout
    assert "2 rank(s) say hello; PETSc counts 2" in done.stdout


def test_every_command_is_documented():
    from pathlib import Path

    import click

    from scaleup.command.cli import cli

    def walk(group, prefix):
        for name, command in group.commands.items():
            path = f"{prefix} {name}"
            if isinstance(command, click.Group):
                yield from walk(command, path)
            else:
                yield path, command

    text = (Path(__file__).parents[1] / "docs" / "commands.md").read_text()
    for path, command in walk(cli, "scaleup"):
        assert command.help, path
        assert path in text, f"{path} is not in docs/commands.md"
        for parameter in command.params:
            for option in parameter.opts:
                if option.startswith("--"):
                    assert option in text, f"{option} of {path} is not in docs/commands.md"


def test_the_configuration_page_is_current(monkeypatch):
    from pathlib import Path

    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    import configuration_page

    assert configuration_page.PAGE.read_text() == configuration_page.page()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--output", "."], "name a folder for the run"),
        (["--output", "file", "--overwrite"], "is a file, not a folder"),
        (["--output", "file/run"], "nothing can be written"),
    ],
)
def test_an_output_that_cannot_be_is_said(refused, tmp_path, arguments, sentence):
    (tmp_path / "file").write_text("mine")
    assert sentence in refused("simulate", *QUICK, *arguments)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_region_that_misses_the_bed_is_said(refused):
    said = refused(
        "simulate", *QUICK, "--output", "run", "--set", "operation.loading.pattern=region",
        "--set", "operation.loading.radius=1 mm",
        "--set", "operation.loading.centre=['0 mm', '60 mm']",
    )  # fmt: skip
    assert "the region holds 0 cells of the settled bed" in said


def test_a_plan_says_what_a_run_would_cost_and_solves_nothing(scaleup, tmp_path):
    scene = ("--flow", "surface-layer", "--set", "geometry.diameter=133 mm")
    asked = ["geometry.diameter=133 mm", "grid.cells=1e5", "mixing.name=lax-wendroff"]
    path = stored_flow(compose(None, asked, {"flow": {"name": "surface-layer"}}))
    plan = scaleup("plan", *scene, "--mixing", "lax-wendroff", "--set", "grid.cells=1e5")
    assert plan.returncode == 0, plan.stderr
    assert "2-D, because the geometry 'drum' is a cross-section" in plan.stdout
    assert "1e+05 full ones in the bed" in plan.stdout
    assert not path.exists()
    assert list(tmp_path.iterdir()) == []
    done = scaleup("simulate", *scene, *QUICK[2:], "--output", "run")
    assert done.returncode == 0, done.stderr
    plan = scaleup("plan", *scene, *QUICK[2:], "--ranks", "2")
    lines = dict(line.split(maxsplit=2)[::2] for line in plan.stdout.splitlines() if "time" in line)
    assert plan.stdout.count("none: it is in the store") == 1
    assert "on 2 rank(s)" in plan.stdout
    assert "scaled from" in plan.stdout
    assert set(lines) == {"flow", "mixing"}
    refused = scaleup("plan", "--geometry", "cement-mixer")
    assert refused.returncode == 2
