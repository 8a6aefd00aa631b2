"""Errors that a user can act on: each carries one sentence and no traceback is shown."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

_LONGEST_SENTENCE, _LONGEST_VALUE = 400, 60  # characters


class ScaleupError(Exception):
    """Base of all errors shown to the user as one sentence; `exit_code` is the process's."""

    exit_code = 1

    def __init__(self, sentence: str = ""):
        """One line, its middle left out where it is too long to be read."""
        super().__init__(shortened(" ".join(sentence.split()), _LONGEST_SENTENCE))


class InputError(ScaleupError):
    """The user asked for something that cannot be: names key, value and rule."""

    exit_code = 2


class PluginError(InputError):
    """A plugin is unknown, ambiguous or broken: names it and its distribution."""


class ContractError(ScaleupError):
    """A plugin broke the contract it was written against: names the rule and the figure."""


class RunError(ScaleupError):
    """A computation could not be finished: says what, where and what to change."""


class UnforeseenError(ScaleupError):
    """An error that no rule foresaw: names the plugin that it came from, else scaleup itself."""


def shortened(text: str, length: int) -> str:
    """The text, or its beginning and end with " ... " between them, of `length` characters."""
    if len(text) <= length:
        return text
    tail = (length - 5) // 2
    return f"{text[: length - 5 - tail]} ... {text[-tail:]}"


def shown(value: Any) -> str:
    """A value as a sentence shows it: as Python writes it, in ASCII, never long."""
    try:
        # what is hidden or looks like another sign is told by its code
        return shortened(ascii(value) if _has_hidden(value) else repr(value), _LONGEST_VALUE)
    except (ValueError, RecursionError):  # whole numbers of thousands of digits, deep nesting
        return f"a {type(value).__name__}"


def _has_hidden(value: Any) -> bool:
    return isinstance(value, str) and not value.isprintable()


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean 'speed'?` if a known name is close to this one, else nothing."""
    lower = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name[:_LONGEST_VALUE].lower(), lower, n=1, cutoff=0.6)
    return f"; did you mean {lower[close[0]]!r}?" if close else ""


def file_error(error: OSError) -> RunError:
    """An error of the file system as one sentence: which file, and what is wrong."""
    return RunError(f"{error.filename or 'a file'}: {error.strerror or error}")
