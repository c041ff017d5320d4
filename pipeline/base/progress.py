"""Progress with time left: a bar on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import sys
import time


def _clock(seconds: float) -> str:
    """[h:]m:ss"""
    minutes, rest = divmod(int(seconds + 0.5), 60)
    if minutes >= 60:
        return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
    return f"{minutes}:{rest:02d}"


class Bar:
    """Counts `total` steps and writes to standard error; use `with Bar(...) as bar:
    bar.step("note")`.
    """

    def __init__(self, label: str, total: int, interval: float | None = None):
        self.label = label
        self.total = total
        self.done = 0

        self.terminal = sys.stderr.isatty()
        self.interval = interval if interval is not None else (0.2 if self.terminal else 5.0)
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

        if final:
            time_left = f"took {_clock(spent)}"
        elif self.done:
            time_left = f"{_clock(spent / self.done * (self.total - self.done))} left"
        else:
            time_left = "? left"

        filled = int(20 * self.done / max(self.total, 1))
        bar = f"[{'#' * filled}{'.' * (20 - filled)}] " if self.terminal else ""
        remark = f"  {note}" if note else ""
        line = f"{self.label}: {bar}{self.done}/{self.total}, {time_left}{remark}"

        start_of_line = "\r\033[K" if self.terminal else ""
        end = "\n" if final or not self.terminal else ""
        print(start_of_line + line, end=end, file=sys.stderr, flush=True)


def progress(iterable, label: str, total: int | None = None):
    """Iterate with a progress bar; `total` defaults to len(iterable)."""
    total = len(iterable) if total is None else total
    with Bar(label, total) as bar:
        for item in iterable:
            yield item
            bar.step()
