"""Files to triangles, in the files' own coordinates; `sound` then sees to it that they close."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np
import trimesh

from scaleup.contract import FloatArray, InputError, IntArray
from scaleup_mesh.apart import UselessFileError, outside_of

_BY_TRIMESH = (".obj", ".off", ".ply")
_HEADER, _FACET = 80, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("", "<u2")])
_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE | re.I)
_OUTER_LOOP = re.compile(rb"^[ \t]*outer[ \t]+loop", re.MULTILINE | re.IGNORECASE)


def read_triangles(file: Path) -> tuple[FloatArray, IntArray, bool]:
    """Vertices (v, 3), triangles (n, 3), and whether they bound volume cells. Raises InputError."""
    where, suffix = f"geometry.file = {str(file)!r}", file.suffix.lower()
    try:
        if suffix == ".stl":
            return *_from_stl(file.read_bytes()), False
        if suffix in _BY_TRIMESH:
            return *_from_trimesh(file.read_bytes(), suffix), False
        return outside_of(file)
    except UselessFileError as refusal:
        raise InputError(f"{where}: {refusal}") from None
    except Exception as error:  # the readers raise whatever their parsers do
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be read as {suffix or 'a mesh'} ({reason})") from error


def _from_stl(content: bytes) -> tuple[FloatArray, IntArray]:
    """Of STL, binary or ASCII, whatever its name's encoding and whatever lies behind its end.

    The number of facets in a binary file is believed if the file is long enough for it; that text
    would be such a number is out of the question, for it would be of 4e8 facets or more.
    """
    start = _HEADER + 4
    count = int.from_bytes(content[_HEADER:start], "little") if len(content) >= start else 0
    if count and start + count * _FACET.itemsize <= len(content):
        corners = np.frombuffer(content, _FACET, count, start)["corners"].reshape(-1, 3)
    else:
        texts = _VERTEX.findall(content)
        loops = len(_OUTER_LOOP.findall(content))
        if not loops:
            wanted = f"{count} facets in binary or facets in ASCII" if count else "facets"
            raise ValueError(f"the file of {len(content)} bytes does not hold {wanted}")
        if len(texts) != 3 * loops:
            raise ValueError(f"{loops} facets have {len(texts)} vertices, not three each")
        corners = np.array(texts, dtype="S").astype(float)
    return corners.astype(float), np.arange(len(corners)).reshape(-1, 3)


def _from_trimesh(content: bytes, suffix: str) -> tuple[FloatArray, IntArray]:
    end = content.find(b"end_header") if suffix == ".ply" else len(content)
    if not content[:end].isascii():  # names and comments in any encoding; what counts is ASCII
        text = content[:end].decode("ascii", "replace").encode("ascii", "replace")
        content = text + content[end:]
    with warnings.catch_warnings(action="ignore"):  # a damaged file gets one sentence
        loaded = trimesh.load_mesh(io.BytesIO(content), file_type=suffix[1:], process=False)
    return np.asarray(loaded.vertices, dtype=float), np.asarray(loaded.faces, dtype=np.int64)
