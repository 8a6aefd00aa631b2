"""The run: config -> geometry -> flow -> FlowField -> mixing -> metrics -> report."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import Any

from scaleup.blending import Blend, mix
from scaleup.config import RunConfig, fill_in_all_kinds
from scaleup.errors import ScaleupError
from scaleup.flow_field import FlowField
from scaleup.flow_source import obtain_flow
from scaleup.output_folder import open_folder, publish
from scaleup.parallel import on_root
from scaleup.planner import record_run
from scaleup.report import compile_report, write_report
from scaleup.results import Results

log = logging.getLogger("scaleup")


def run(
    config: RunConfig, folder: Path, comm: Any, *, overwrite: bool, resume: bool, force: bool
) -> Path:
    """Run a configuration; collective. Returns the run folder.

    The folder appears when the run is complete; until then its content is in `FOLDER.partial`,
    from which `resume` goes on.
    """
    work = on_root(
        comm,
        partial(open_folder, folder, config.to_toml(), overwrite=overwrite, resume=resume),
    )
    handler = _log_to(work / "run.log") if comm.rank == 0 else None
    try:
        log.info("scaleup on %d rank(s); %s", comm.size, _describe(config))
        outcome = obtain_flow(config, comm)
        results = Results.of(work, outcome.flow)
        kept = work / "checkpoint.h5"
        blend = mix(config, outcome.flow, comm, results=results, checkpoint=kept, force=force)
        coarse = _coarse_blend(config, outcome.flow, comm, force)
        if comm.rank == 0:
            results.write_xdmf()
            record_run(config, outcome, blend, comm.size)
            report = compile_report(config, outcome, blend, coarse, comm.size)
            write_report(work, report, results, config.plugin("geometry"))
    finally:
        if handler is not None:
            log.removeHandler(handler)
            handler.close()
    on_root(comm, partial(publish, work, folder))
    return folder


def _coarse_blend(config: RunConfig, flow: FlowField, comm: Any, force: bool) -> Blend | str:
    """The blend on cells twice as large, or why there is none; a finished run is never lost."""
    if not config.accuracy.estimate:
        return "accuracy.estimate is off"
    log.info("mixing again on cells twice as large, for the error estimate")
    try:
        return mix(config, flow.coarsened(2), comm, force=force)
    except ScaleupError as error:
        return f"on cells twice as large: {error}"


def _log_to(path: Path) -> logging.Handler:
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    return handler


def _describe(config: RunConfig) -> str:
    fill = fill_in_all_kinds(config)
    return (
        f"geometry {config.geometry['name']}, flow {config.flow['name']}, mixing "
        f"{config.mixing['name']}, {config.operation.speed:.4g} rad/s, fill depth ratio "
        f"{fill['depth_ratio']:.4f} = volume fraction {fill['volume_fraction']:.4f} = "
        f"{fill['mass']:.4g} kg"
    )
