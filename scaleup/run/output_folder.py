"""The run folder: it appears when a run is complete, and is never half a run.

Until then the content lies in `FOLDER.partial`, from which `scaleup resume FOLDER` goes on. A
finished run is extended in a `FOLDER.partial`, too, and stays as it is until that is complete.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

from scaleup.system.errors import InputError
from scaleup.system.files import remove_leftovers, temporary_name, write_text
from scaleup.system.run_lock import require_free

ENGINE_FOLDER = "engine"
"""of a run of grains: what their engine reads and writes"""
_EXTENDED = ("checkpoint.h5", "estimate.h5", "results.h5")
"""what a run is extended from; such files are replaced and never changed, so links will do"""


def real_folder(folder: Path) -> Path:
    """The folder that a run is written to: where a symbolic link leads, to a folder or to none."""
    if not folder.is_symlink():
        return folder
    try:
        return folder.resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(f"--output {folder}: is a symbolic link that leads nowhere") from error


def work_folder(folder: Path) -> Path:
    """Where an unfinished run lies. Raises InputError for a folder without a name of its own."""
    if folder.name in ("", ".."):
        raise InputError(f"--output {str(folder)!r}: name a folder for the run")
    return folder.with_name(folder.name + ".partial")


def begun_configuration(folder: Path) -> Path:
    """`config.toml` of the unfinished run of a folder, else of its finished one."""
    unfinished = work_folder(folder) / "config.toml"
    return unfinished if unfinished.exists() else folder / "config.toml"


def holds_grains(folder: Path) -> bool:
    """Whether a folder, or the unfinished run of it, is of `scaleup particles`."""
    return any((place / ENGINE_FOLDER).is_dir() for place in (work_folder(folder), folder))


def check_output(folder: Path, *, overwrite: bool, resume: bool, extend: bool = False) -> None:
    """Raise InputError if a run may not be written to this folder.

    extend -- whether a finished run may be gone on with, too
    """
    work = work_folder(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output {folder}: is a file, not a folder")
    if folder.is_mount():
        raise InputError(f"--output {folder}: is a file system of its own; name a folder inside it")
    parent = next(p for p in folder.absolute().parents if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(f"--output {folder}: nothing can be written to {parent}")
    require_free(folder)
    if work.exists() and any(work.iterdir()) and not (work / "config.toml").exists():
        raise InputError(f"--output {folder}: {work} is in the way and is not an unfinished run")
    if resume:
        if (work / "config.toml").exists():
            return
        if not _is_run(folder):
            raise InputError(f"{folder}: there is no unfinished run to resume ({work} is missing)")
        if holds_grains(folder):
            raise InputError(
                f"{folder}: this run of grains is finished, and its restart files are gone; "
                "compute a longer one anew"
            )
        if not extend:
            raise InputError(f"{folder}: this run is finished; --revolutions X goes on with it")
        return
    if overwrite:
        if folder.exists() and any(folder.iterdir()) and not _is_run(folder):
            raise InputError(f"--output {folder}: is not a run folder; --overwrite leaves it alone")
        return
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"--output {folder}: is there already; give another or add --overwrite")
    if work.exists():
        raise InputError(
            f"--output {folder}: an unfinished run is there; 'scaleup resume {folder}' goes on "
            "with it, --overwrite discards it"
        )


def open_folder(folder: Path, config_toml: str, *, resume: bool) -> Path:
    """The folder to work in, with its config.toml; the caller holds the lock and has checked."""
    work = work_folder(folder)
    if not resume and work.exists():
        shutil.rmtree(work)
    if resume and not work.exists():
        _extend(folder, work)
    work.mkdir(parents=True, exist_ok=True)
    for place in (work, work / "fields"):
        remove_leftovers(place, alone=True)
    write_text(work / "config.toml", config_toml)
    return work


def publish(work: Path, folder: Path) -> None:
    """Put the finished run in its place; what it overwrites goes only then."""
    remove_leftovers(work, alone=True)
    old = folder.with_name(f".{folder.name}.old")
    if os.path.lexists(folder):
        _remove(old)  # left by a run that was killed between the two lines below
        os.replace(folder, old)
    os.replace(work, folder)
    with contextlib.suppress(OSError):  # the run is in its place; the next one tries again
        _remove(old)


def _extend(folder: Path, work: Path) -> None:
    """Begin an unfinished run from a finished one, all at once."""
    for left in work.parent.glob(f".{work.name}.*.tmp"):  # by a process that was killed here
        _remove(left)
    new = temporary_name(work)
    new.mkdir()
    for name in _EXTENDED:
        if (folder / name).exists():
            try:
                os.link(folder / name, new / name)
            except OSError:  # a file system without links
                shutil.copy2(folder / name, new / name)
    for name in ("config.toml", "run.log"):  # those are written on
        if (folder / name).exists():
            shutil.copy2(folder / name, new / name)
    os.replace(new, work)


def _is_run(folder: Path) -> bool:
    kept = ("report.json", "checkpoint.h5", "results.h5")
    return (folder / "config.toml").exists() and any((folder / name).exists() for name in kept)


def _remove(path: Path) -> None:
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)
