"""HDF5 files: the one place where they are opened, and where their errors become a sentence.

HDF5 reports a full disk, a truncated file or a missing dataset as OSError, RuntimeError, KeyError
and others, without the file's name; and after a write that failed it crashes when it is asked to
close. So files that are replaced as a whole are built in memory and written by ordinary means.
"""

from __future__ import annotations

import atexit
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# Its locks are not to be had on every file system of a cluster, and no file is written in place.
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")

import h5py

from scaleup.system.errors import RunError, ScaleupError
from scaleup.system.files import write_bytes

FORMAT_VERSION = 4
"""of all HDF5 files of this version of scaleup, in their attribute `format_version`"""


class DamagedFileError(RunError):
    """A file that is there does not hold what it should."""


@contextmanager
def replaced(path: Path) -> Iterator[Any]:
    """A new file, filled in the block, that takes the place of `path` when that ends well."""
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs["format_version"] = FORMAT_VERSION
        yield file
    write_bytes(path, image.getbuffer())


@contextmanager
def reading(path: Path) -> Iterator[Any]:
    """A file to read from in the block. Whatever goes wrong there is the file's fault.

    Raises DamagedFileError; RunError if there is no such file.
    """
    with understood(path), opened(path) as file:
        yield file


def opened(path: Path) -> Any:
    """An open file to read from, of this version of the format. Raises DamagedFileError."""
    if not os.path.lexists(path):
        raise RunError(f"{path}: is missing")
    with understood(path):
        if not path.is_file():
            raise ValueError("not a file")
        file = h5py.File(path, "r")
        try:
            _require_version(file)
        except BaseException:
            file.close()
            raise
        return file


@contextmanager
def understood(path: Path) -> Iterator[None]:
    """Whatever goes wrong in the block is the fault of a file. Raises DamagedFileError."""
    try:
        yield
    except (ScaleupError, MemoryError):
        raise
    except Exception as error:
        raise DamagedFileError(f"{path}: is damaged or of another kind: {reason(error)}") from error


@contextmanager
def written(path: Path) -> Iterator[None]:
    """Failures of HDF5 to write a file, as a sentence. Raises RunError."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        if not _failures:
            atexit.register(_leave)
        _failures.append(error)
        raise RunError(f"{path}: {reason(error)}") from error


# HDF5 crashes when objects of a file that it failed to write are released. They are alive in the
# errors' frames; the process ends without releasing them.
_failures: list[Exception] = []


def _leave() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(RunError.exit_code)


def reason(error: Exception) -> str:
    """What HDF5 says, in a few words."""
    if isinstance(error, OSError) and error.errno and error.strerror:
        return os.strerror(error.errno)
    text = " ".join(str(error.args[0] if error.args else error).split())
    for name in ("No space left on device", "File too large", "Disk quota exceeded"):
        if name in text:
            return name
    return text[:1].lower() + text[1:200]


def _require_version(file: Any) -> None:
    version = file.attrs.get("format_version")
    if version is None:
        raise ValueError("no file of scaleup's: format_version is missing")
    if version != FORMAT_VERSION:
        age = "an older" if version < FORMAT_VERSION else "a newer"
        raise ValueError(
            f"format_version {version} is of {age} version of scaleup, which alone can read it "
            f"(this one has {FORMAT_VERSION})"
        )
