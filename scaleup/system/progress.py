"""Progress of long work, with an estimate of what remains: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

log = logging.getLogger("scaleup")

_SECONDS_BETWEEN_LINES = 10.0


class Reporter:
    """Callable as `progress(fraction, message)`; silent on ranks other than the root."""

    def __init__(self, title: str, visible: bool):
        self._title, self._visible = title, visible
        self._started = self._last_line = time.monotonic()
        self._bar: Progress | None = None
        if visible and sys.stderr.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.percentage:3.0f}%"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[message]}"),
                console=Console(stderr=True),
            )
            self._task = self._bar.add_task(title, total=1.0, message="")

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._bar:
            self._bar.stop()

    def __call__(self, fraction: float, message: str) -> None:
        """Say how far the work is, in [0, 1]."""
        if not self._visible:
            return
        if self._bar:
            self._bar.update(self._task, completed=fraction, message=message)
            return
        now = time.monotonic()
        if now - self._last_line >= _SECONDS_BETWEEN_LINES and 0 < fraction < 1:
            self._last_line = now
            left = (now - self._started) * (1 - fraction) / fraction
            log.info("%s %3.0f %%, %.0f s left; %s", self._title, 100 * fraction, left, message)
