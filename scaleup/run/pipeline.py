"""The run: case -> geometry -> flow -> FlowField -> mixing -> metrics -> report."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from scaleup.case.case import Case
from scaleup.flow.source import FlowOutcome, obtain_flow
from scaleup.measure.blend import Blend
from scaleup.report.compile import compile_report, write_json, write_report
from scaleup.report.results import Results
from scaleup.run.blending import check_resumable, mix
from scaleup.run.output_folder import check_output, open_folder, publish
from scaleup.run.planner import record_run
from scaleup.space.flow_field import FlowField
from scaleup.system.crew import Crew
from scaleup.system.errors import ScaleupError
from scaleup.system.parallel import all_end, on_root
from scaleup.system.run_lock import RunLock
from scaleup.system.stopping import StoppedError, Stopping

log = logging.getLogger("scaleup")


def run(
    case: Case,
    folder: Path,
    comm: Any,
    *,
    overwrite: bool = False,
    resume: bool = False,
    force: bool = False,
    changed_code: bool = False,
    all_ranks: bool = False,
) -> Path:
    """Run a configuration; collective. Returns the run folder.

    The folder appears when the run is complete; until then its content is in `FOLDER.partial`,
    from which `resume` goes on, on a finished run too. Meanwhile the folder is locked. A signal
    ends the run with a StoppedError or at once (`scaleup.system.stopping`).
    """
    lock, stopping, crew = RunLock(folder), Stopping(), Crew(comm, all_ranks=all_ranks)
    on_root(comm, lock.take)
    try:
        with stopping.heeded(lock.release):
            on_root(
                comm, partial(check_output, folder, overwrite=overwrite, resume=resume, extend=True)
            )
            work = on_root(comm, partial(open_folder, folder, case.to_toml(), resume=resume))
            with logged_to(work / "run.log", root=comm.rank == 0):
                blending = partial(mix, case, comm=comm, force=force, stopping=stopping,
                                   changed_code=changed_code, crew=crew)  # fmt: skip
                _run_in(work, case, comm, stopping, blending, changed_code)
            on_root(comm, partial(publish, work, folder))
    finally:
        if comm.rank == 0:
            lock.release()
    return folder


def _run_in(
    work: Path,
    case: Case,
    comm: Any,
    stopping: Stopping,
    blending: Callable[..., Blend],
    changed_code: bool,
) -> None:
    """Everything that is in a run folder but its lock; collective."""
    log.info("scaleup on %d rank(s); %s", comm.size, _describe(case))
    kept, estimated = work / "checkpoint.h5", work / "estimate.h5"
    on_root(comm, partial(check_resumable, case, kept, changed_code=changed_code))
    outcome = obtain_flow(case, comm)
    results = Results.of(work, outcome.flow)
    stopping.at_once = False
    blend = blending(outcome.flow, results=results, checkpoint=kept)
    coarse = _coarse_blend(case, outcome.flow, partial(blending, checkpoint=estimated))
    stopping.at_once = True
    if comm.rank == 0:
        _report(work, case, outcome, blend, coarse, comm.size, results)


def _coarse_blend(case: Case, flow: FlowField, blending: Callable[..., Blend]) -> Blend | str:
    """The blend on cells twice as large, or why there is none; a finished run is never lost."""
    if not case.accuracy.estimate:
        return "accuracy.estimate is off"
    log.info("mixing again on cells twice as large, for the error estimate")
    try:
        return blending(flow.coarsened(2))
    except StoppedError:
        raise
    except ScaleupError as error:
        if not all_end():  # this rank alone failed: the others are somewhere else
            raise
        return f"on cells twice as large: {error}"


def _report(
    work: Path,
    case: Case,
    outcome: FlowOutcome,
    blend: Blend,
    coarse: Blend | str,
    ranks: int,
    results: Results,
) -> None:
    """Say what came of a run, in its folder and in the store. Whatever fails here is a warning."""
    with _finished_all_the_same("costs.jsonl, for estimates of later runs", blend):
        record_run(case, outcome, blend)
    with _finished_all_the_same("results.xdmf", blend):
        results.write_xdmf()
    with _finished_all_the_same("the report", blend):
        report = compile_report(case, outcome, blend, coarse, ranks)
        write_json(work, report)
        with _finished_all_the_same("the figures", blend):
            write_report(work, report, results, case.geometry)
            return
        write_json(work, compile_report(case, outcome, blend, coarse, ranks))


@contextmanager
def _finished_all_the_same(what: str, blend: Blend) -> Iterator[None]:
    """What comes after the computation may fail without taking the result along."""
    try:
        yield
    except Exception as error:
        sentence = f"{what} could not be written: {' '.join(str(error).split()) or repr(error)}"
        log.warning("the run is complete, but %s", sentence, exc_info=log.level <= logging.DEBUG)
        blend.remarks.append(sentence)


@contextmanager
def logged_to(path: Path, *, root: bool) -> Iterator[None]:
    """What is logged within the block goes to a file as well, on the root."""
    if not root:
        yield
        return
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        handler.close()


def _describe(case: Case) -> str:
    fill = case.fill_in_all_kinds
    return (
        f"geometry {case.name('geometry')}, flow {case.name('flow')}, mixing "
        f"{case.name('mixing')}, {case.operation.speed:.4g} rad/s, fill depth ratio "
        f"{fill['depth_ratio']:.4f} = volume fraction {fill['volume_fraction']:.4f} = "
        f"{fill['mass']:.4g} kg"
    )
