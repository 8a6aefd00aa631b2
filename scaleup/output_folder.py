"""The run folder: it appears when a run is complete, and is never half a run.

Until then the content lies in `FOLDER.partial`, from which `scaleup resume FOLDER` goes on.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from scaleup.errors import InputError
from scaleup.files import write_text


def work_folder(folder: Path) -> Path:
    """Where an unfinished run lies. Raises InputError for a folder without a name of its own."""
    if folder.name in ("", ".."):
        raise InputError(f"--output {str(folder)!r}: name a folder for the run")
    return folder.with_name(folder.name + ".partial")


def check_output(folder: Path, *, overwrite: bool, resume: bool) -> None:
    """Raise InputError if a run may not be written to this folder."""
    work = work_folder(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output {folder}: is a file, not a folder")
    parent = next(p for p in folder.absolute().parents if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(f"--output {folder}: nothing can be written to {parent}")
    if work.exists() and any(work.iterdir()) and not (work / "config.toml").exists():
        raise InputError(f"--output {folder}: {work} is in the way and is not an unfinished run")
    if resume:
        if not (work / "config.toml").exists():
            raise InputError(f"{folder}: there is no unfinished run to resume ({work} is missing)")
        return
    if overwrite:
        if folder.exists() and any(folder.iterdir()) and not (folder / "report.json").exists():
            raise InputError(f"--output {folder}: is not a run folder; --overwrite leaves it alone")
        return
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"--output {folder}: is there already; give another or add --overwrite")
    if work.exists():
        raise InputError(
            f"--output {folder}: an unfinished run is there; 'scaleup resume {folder}' goes on "
            "with it, --overwrite discards it"
        )


def open_folder(folder: Path, config_toml: str, *, overwrite: bool, resume: bool) -> Path:
    """The folder to work in, with its config.toml; checks first as `check_output`."""
    check_output(folder, overwrite=overwrite, resume=resume)
    work = work_folder(folder)
    if not resume:
        if work.exists():
            shutil.rmtree(work)
        work.mkdir(parents=True)
        write_text(work / "config.toml", config_toml)
    return work


def publish(work: Path, folder: Path) -> None:
    """Put the finished run in its place; what it overwrites goes only then."""
    old = folder.with_name(f".{folder.name}.old")
    if folder.exists():
        if old.exists():  # left by a run that was killed between the two lines below
            shutil.rmtree(old)
        os.replace(folder, old)
    os.replace(work, folder)
    if old.exists():
        shutil.rmtree(old)
