"""The run of a particle twin: case -> grains -> engine -> frames -> measures -> report."""

from __future__ import annotations

import logging
import shutil
import time
import tomllib
from pathlib import Path
from typing import Any

from scaleup.case.case import Case
from scaleup.particles.computing import Computation
from scaleup.particles.engine import require_engine
from scaleup.particles.measuring import measure_frames
from scaleup.particles.reporting import compile_particle_report
from scaleup.report.compile import write_json, write_report
from scaleup.run.output_folder import (
    ENGINE_FOLDER,
    check_output,
    open_folder,
    publish,
    work_folder,
)
from scaleup.run.pipeline import logged_to
from scaleup.scene.units import LENGTH
from scaleup.system.errors import InputError
from scaleup.system.files import write_text
from scaleup.system.run_lock import RunLock
from scaleup.system.stopping import Stopping

log = logging.getLogger("scaleup")

_BEGUN = "begun.toml"
_LEAST_DEEP, _MOST = 4, 2e7  # grains: depth of the bed, number
_RATE = 1e6  # particle-steps per core-second, for the estimate


def run_particles(
    case: Case, folder: Path, ranks: int, *, overwrite: bool = False, resume: bool = False
) -> Path:
    """Compute a scene with grains; returns the run folder, which appears when all is done.

    resume -- go on from what is in `FOLDER.partial`
    Raises InputError, before anything is computed, for what cannot be; RunError if the engine
    fails.
    """
    require_engine(ranks)
    check_output(folder, overwrite=overwrite, resume=resume)
    computation = Computation(case, work_folder(folder) / ENGINE_FOLDER, ranks)
    _require_grains(case, computation)
    lock, stopping = RunLock(folder), Stopping()

    def last_act() -> None:
        computation.engine.end()
        lock.release()

    lock.take()
    try:
        with stopping.heeded(last_act):
            if resume:
                _require_begun(case, work_folder(folder) / ENGINE_FOLDER / _BEGUN)
            work = open_folder(folder, case.to_toml(), resume=resume)
            with logged_to(work / "run.log", root=True):
                _run_in(work, case, computation, ranks)
            publish(work, folder)
    finally:
        lock.release()
    return folder


def _run_in(work: Path, case: Case, computation: Computation, ranks: int) -> None:
    plan, contact = computation.schedule, computation.contact
    engine = work / ENGINE_FOLDER
    engine.mkdir(exist_ok=True)
    write_text(engine / _BEGUN, case.to_toml())
    steps = plan.steps * plan.frames * plan.stretches
    log.info(
        "%d grains of %s, shear modulus %.3g Pa, %d steps of %.3g s: about %.2g core-hours",
        computation.count, LENGTH.shown(contact.diameter), contact.shear_modulus, steps,
        plan.time_step, computation.count * steps / _RATE / 3600,
    )  # fmt: skip
    computed = computation.run()
    began = time.monotonic()
    measured, results = measure_frames(case, computation, computed, work)
    report = compile_particle_report(case, computation, measured, ranks, time.monotonic() - began)
    results.write_xdmf()
    write_json(work, report)
    write_report(work, report, results, case.geometry)
    for left in (*engine.glob("*.restart"), engine / "grains.data"):
        left.unlink(missing_ok=True)
    shutil.rmtree(engine / "frames")


def _require_grains(case: Case, computation: Computation) -> None:
    """Raise InputError for grains too large for the bed, or too many."""
    diameter, deep = computation.contact.diameter, case.bed.depth
    if deep < _LEAST_DEEP * diameter:
        raise InputError(
            f"particles.diameter = {LENGTH.shown(diameter)} (times particles.coarse): the bed is "
            f"{LENGTH.shown(deep)} deep, less than {_LEAST_DEEP} grains"
        )
    if computation.count > _MOST:
        raise InputError(
            f"particles.diameter = {LENGTH.shown(diameter)}: {computation.count:.3g} grains are "
            f"more than {_MOST:g}; take larger ones (particles.coarse)"
        )


def _require_begun(case: Case, begun: Path) -> None:
    """Raise InputError unless the case is the one that was begun, but for the revolutions."""
    if not begun.exists():
        return  # ended before anything was computed

    def compared(text: str) -> dict[str, Any]:
        tables = tomllib.loads(text)
        tables["operation"].pop("revolutions")
        return tables

    if compared(begun.read_text(encoding="utf-8")) != compared(case.to_toml()):
        raise InputError(
            f"{begun.parent.parent / 'config.toml'}: has changed; a run goes on only as it was "
            "begun"
        )
