"""Processes on machines: whether the one that holds a lock or left a file behind is alive."""

from __future__ import annotations

import hashlib
import os
import socket
from functools import cache
from pathlib import Path

_PROC = Path("/proc")


@cache
def host() -> str:
    """Where process numbers mean something: a machine since it was started, or a container on it.

    The machine's name, a hyphen and 8 hexadecimal digits.
    """
    name = socket.gethostname().partition(".")[0]
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        space = os.readlink(_PROC / "self/ns/pid")
    except OSError:  # not a Linux: the name has to do
        boot = space = ""
    return f"{name}-{hashlib.sha256(f'{boot} {space}'.encode()).hexdigest()[:8]}"


def started(pid: int) -> str | None:
    """When a process of this host was started, in the kernel's clock; None if there is none."""
    try:
        line = (_PROC / str(pid) / "stat").read_bytes()
    except OSError:
        return None if _PROC.is_dir() or not _exists(pid) else ""
    state, *fields = line.rpartition(b")")[2].split()
    return None if state in b"ZX" else fields[18].decode()  # a zombie does nothing any more


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
