"""Values that cannot be are refused at the start, in one sentence of key, value and rule."""

import pytest

from scaleup.case import feasibility
from scaleup.case.composing import compose
from scaleup.system.errors import InputError

REGION = ("operation.loading.pattern=region", "operation.loading.centre=['0 mm', '{y} mm']",
          "operation.loading.radius={r} mm")  # fmt: skip
GENERAL = ("flow.model=general",)
THREE = ("operation.loading.shares=[0.2, 0.3, 0.5]",)


def region(y, r):
    return [text.format(y=y, r=r) for text in REGION]


@pytest.mark.parametrize(
    ("assignments", "sentence"),
    [
        (["operation.fill.volume_fraction=1e-300"], "less than 4 grains of 1 mm"),
        (["operation.fill.volume_fraction=0.9999"], "0.9999 of the vessel leaves no room to flow"),
        (["operation.fill.depth_ratio=0.99"], "leaves no room to flow; at most 0.95 of it"),
        (["operation.fill.mass=1 mg"], "operation.fill.mass = 1e-06 kg: the bed is"),
        (["material.grain_diameter=200 mm"], "material.grain_diameter = 200 mm: the bed is 49 mm"),
        (["grid.spacing=50 mm"], "grid.spacing = 50 mm: the bed, 49 mm deep, holds 1.92 cells"),
        (["grid.spacing=1 um"], "cells are 1.96e+10 in the vessel's box, more than 2e+09"),
        (["accuracy.scrutiny=1000"], "accuracy.scrutiny = 1000: samples of 1 m do not fit"),
        (["accuracy.sample_mass=1 kg"], "accuracy.sample_mass = 1 kg: samples of 87.36 mm do not"),
        (["operation.revolutions=1e-9"], "operation.revolutions = 1e-09: must be at least 0.001"),
        (["operation.revolutions=10000"], "output.metrics_every = 0.05: over 10000 revolutions"),
        (["output.snapshots_every=0.001", "operation.revolutions=200"], "output.snapshots_every ="),
        (["mixing.time_step=1e-12"], "3 revolutions take 3e+13 mixing steps or more"),
        (["mixing.courant=1e-9"], "mixing.courant = 1e-09: 3 revolutions take 4.4e+12 mixing"),
        (["diffusion.after=5"], "must be at most operation.revolutions = 3"),
        (["operation.loading.shares=[1e-9, 0.999999999]"], "holds 5.3e-05 of a cell"),
        (region(50, 5), "the region holds 0 cells of the settled bed, which ends at y = -21 mm"),
        (region(-50, 0.1), "the region holds 0.35 cells"),
        (region(-50, 150), "the region is the whole bed; there is nothing to blend"),
        (region(-50, 5000), "the region is the whole bed"),
        (["flow.intervals=40"], "flow.intervals = 40: belongs to the form 'general' (any vessel"),
        ([*GENERAL, "flow.thickness=5 mm"], "belongs to the form 'closed-form' (a drum"),
        (["flow.thickness=5 mm"], "flow.thickness = '5 mm': belongs to the closure 'parabolic'"),
        (["flow.name=mohr-coulomb", "flow.revolutions=3"], "this scene takes the form 'plane'"),
        ([*GENERAL, "flow.column_spacing=3"], "reaches 70 mm; did you mean \"3 mm\"?"),
        ([*GENERAL, "flow.column_spacing=1 um"], "spacing = 1 um: must be from 0.14 mm to 14 mm"),
        (["flow.name=mohr-coulomb", "flow.fine_size=1 um"], "must be from 0.14 mm to 23.33 mm"),
        (["flow.name=mohr-coulomb", "flow.time_step=1 ns"], "flow.time_step = 1e-09 s: must be"),
        (["mixing.name=implicit-fem", "mixing.petsc_options=hello"], "'hello' is no option"),
        (["mixing.name=implicit-fem", "mixing.petsc_options=-pc_type 'gm"], "no closing quotation"),
        (["mixing.name=implicit-fem", "mixing.petsc_options=-snes_type ls"], "of a linear solver"),
        (["mixing.name=lax-wendroff", "mixing.form=paper", *THREE],
         "clips two components, not 3"),
        (["geometry.end_walls=true", "diffusion.model=paper"], "Eq. 6 holds for a 2-D flow"),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else "",
)  # fmt: skip
def test_what_cannot_be_is_refused_before_anything_is_computed(assignments, sentence):
    with pytest.raises(InputError) as caught:
        compose(None, ["flow.name=surface-layer", *assignments])
    assert sentence.lower() in str(caught.value).lower()
    assert "\n" not in str(caught.value)


def test_memory_beyond_the_machines_is_refused_with_both(monkeypatch):
    monkeypatch.setattr(feasibility, "machine_memory", lambda: 1e9)
    with pytest.raises(InputError, match=r"need 12\.7 GB of memory or more; this machine has 1 GB"):
        compose(None, ["grid.spacing=10 um", "flow.name=surface-layer"])


def test_the_limits_leave_room_for_what_can_be():
    """Beside each limit a value that is accepted."""
    for assignments in (
        ["operation.fill.volume_fraction=0.94"],
        ["material.grain_diameter=12 mm", "accuracy.scrutiny=1"],
        ["operation.revolutions=0.001"],
        ["diffusion.after=3"],
        ["operation.loading.shares=[0.0001, 0.9999]"],
        region(-50, 0.4),
        region(-50, 60),
        ["mixing.name=implicit-fem", "mixing.petsc_options=-ksp_rtol 1e-5 -pc_type ilu"],
    ):
        compose(None, ["flow.name=surface-layer", *assignments])
