"""Text files: read as editors save them; written whole, so that nobody meets half of one."""

from __future__ import annotations

import codecs
import contextlib
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scaleup.system import processes

_TEMPORARY = re.compile(r"\..+\.(?P<host>[^/]+-[0-9a-f]{8})\.(?P<pid>\d+)\.tmp")
_FORGOTTEN = 7 * 86400.0  # s after which a temporary file of another host is taken for left behind


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends well."""
    temporary = temporary_name(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def temporary_name(path: Path) -> Path:
    """A name beside `path` that no other process uses, on this host or another one."""
    return path.with_name(f".{path.name}.{processes.host()}.{os.getpid()}.tmp")


def remove_leftovers(folder: Path, *, alone: bool) -> None:
    """Remove temporary files of processes that were killed.

    alone -- nobody else writes to the folder, so that all of them are such. Otherwise those of this
             host whose process has ended, and of others when they are a week old.
    """
    for path in folder.glob(".*.tmp"):
        found = _TEMPORARY.fullmatch(path.name)
        if found is None:
            continue
        with contextlib.suppress(OSError):  # another process may have been faster
            if found["host"] == processes.host():
                dead = processes.started(int(found["pid"])) is None
            else:
                dead = time.time() - path.stat().st_mtime > _FORGOTTEN
            if alone or dead:
                path.unlink()


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file at once; it is on the disk when it takes its place."""
    with replacing(path) as temporary:
        try:
            with temporary.open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:  # a full disk's error names no file
            raise OSError(error.errno, error.strerror, str(path)) from error


def read_text(path: Path) -> str:
    """The text of a file in UTF-8 or, if it begins with the mark of that, UTF-16.

    Line ends are those of any system; a mark at the beginning is left out. Raises OSError and
    UnicodeDecodeError.
    """
    content = path.read_bytes()
    utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = content.decode("utf-16" if utf16 else "utf-8-sig")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file at once."""
    write_bytes(path, text.encode("utf-8"))
