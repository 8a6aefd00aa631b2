"""A run folder belongs to one run at a time.

The lock is a file beside the folder, made with O_EXCL, which is atomic on network file systems too;
it names the host, the process and when that was started. It is stale, and taken over, if

- this host made it and the process is gone, or has been started at another time;
- another host made it and has not touched it for `_SILENT` s by the file system's own clock. The
  process that holds a lock touches it every `_HEARTBEAT` s.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scaleup.system import processes
from scaleup.system.errors import InputError
from scaleup.system.files import temporary_name

_HEARTBEAT, _SILENT = 30.0, 600.0


def require_free(folder: Path) -> None:
    """Raise InputError if another run that is alive holds the folder."""
    path = _path(folder)
    content = _content(path)
    if content is not None and content != _own() and _is_alive(path, content):
        raise _held(folder, content)


class RunLock:
    """The lock of a run folder, held from `take` to `release`."""

    def __init__(self, folder: Path):
        self._folder, self._path = folder, _path(folder)
        self._released = threading.Event()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock in the block. Raises InputError if a run that is alive has it."""
        self.take()
        threading.Thread(target=self._stay_fresh, daemon=True).start()
        try:
            yield
        finally:
            self.release()

    def take(self) -> None:
        """Make the lock, in place of a stale one. Raises InputError if there is a fresh one."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            try:
                descriptor = os.open(self._path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
            except FileExistsError:
                self._remove_stale()
                continue
            os.write(descriptor, _own())
            os.close(descriptor)
            return

    def release(self) -> None:
        """Give the folder back; does nothing without the lock."""
        self._released.set()
        if _content(self._path) == _own():
            self._path.unlink(missing_ok=True)

    def _remove_stale(self) -> None:
        content = _content(self._path)
        if content is None:
            return
        if _is_alive(self._path, content):
            raise _held(self._folder, content)
        aside = temporary_name(self._path)
        with contextlib.suppress(FileNotFoundError):  # another process was faster
            os.rename(self._path, aside)
            if _content(aside) != content:  # and has made its own already: give that back
                with contextlib.suppress(FileExistsError):
                    os.link(aside, self._path)
        aside.unlink(missing_ok=True)

    def _stay_fresh(self) -> None:
        while not self._released.wait(_HEARTBEAT):
            with contextlib.suppress(OSError):
                os.utime(self._path)


def _own() -> bytes:
    pid = os.getpid()
    holder = {"host": processes.host(), "pid": pid, "started": processes.started(pid)}
    return json.dumps(holder).encode()


def _path(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.lock")


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def _is_alive(path: Path, content: bytes) -> bool:
    holder = _parsed(content)
    if holder.get("host") == processes.host():
        started = processes.started(int(holder["pid"]))
        return started is not None and started == holder.get("started")
    now = temporary_name(path)
    now.touch()
    try:
        return now.stat().st_mtime - path.stat().st_mtime < _SILENT
    except FileNotFoundError:
        return False
    finally:
        now.unlink(missing_ok=True)


def _parsed(content: bytes) -> dict[str, Any]:
    """What a lock says; nothing if it was just made or is no such file: then its age counts."""
    try:
        holder = json.loads(content)
        return {**holder, "pid": int(holder["pid"])}
    except (ValueError, TypeError, KeyError):
        return {}


def _held(folder: Path, content: bytes) -> InputError:
    holder = _parsed(content)
    return InputError(
        f"{folder}: a run is under way there, as process {holder.get('pid', '?')} on "
        f"{holder.get('host', 'another host')}; wait for it or end it"
    )
