"""Progress with time left: a bar on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import sys
import time


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds + 0.5), 60)
    return (
        f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
        if minutes >= 60
        else f"{minutes}:{rest:02d}"
    )


class Bar:
    """Counts `total` steps and writes to standard error; use `with Bar(...) as bar:
    bar.step("note")`.
    """

    def __init__(self, label: str, total: int, interval: float | None = None):
        self.label, self.total, self.done = label, total, 0
        self.tty = sys.stderr.isatty()
        self.interval = interval if interval is not None else (0.2 if self.tty else 5.0)
        self.start = self.last = time.monotonic()

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self._write("", final=True)

    def step(self, note: str = "", count: int = 1) -> None:
        self.done += count
        if time.monotonic() - self.last >= self.interval:
            self._write(note)

    def _write(self, note: str, final: bool = False) -> None:
        self.last = time.monotonic()
        spent = self.last - self.start
        left = spent / self.done * (self.total - self.done) if self.done else None
        time_left = (
            f"took {_clock(spent)}"
            if final
            else f"{_clock(left) if left is not None else '?'} left"
        )
        filled = int(20 * self.done / max(self.total, 1))
        bar = f"[{'#' * filled}{'.' * (20 - filled)}] " if self.tty else ""
        line = (
            f"{self.label}: {bar}{self.done}/{self.total}, {time_left}{'  ' + note if note else ''}"
        )
        end = "\n" if final or not self.tty else ""
        print(("\r\033[K" if self.tty else "") + line, end=end, file=sys.stderr, flush=True)


def progress(iterable, label: str, total: int | None = None):
    """Iterate with a progress bar; `total` defaults to len(iterable)."""
    total = len(iterable) if total is None else total
    with Bar(label, total) as bar:
        for item in iterable:
            yield item
            bar.step()
