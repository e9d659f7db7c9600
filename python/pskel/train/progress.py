"""The progress line: step, loss, rate, time left."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import TextIO

__all__ = ["Progress", "duration"]

_LINES_S = 5.0
_TERMINAL_S = 0.2
_WINDOW_S = 60.0
"""The rate is that of the last minute."""


class Progress:
    """Writes to standard error: on a terminal one line that changes, else a line every few seconds."""

    def __init__(self, steps: int, clips: int, stream: TextIO | None = None, *, active: bool = True) -> None:
        self._steps = steps
        self._clips = clips
        self._stream = sys.stderr if stream is None else stream
        self._active = active
        self._is_terminal = self._stream.isatty()
        self._times: deque[tuple[float, int]] = deque()
        self._last = 0.0
        self._width = 0

    def step(self, done: int, loss: float, now: float | None = None) -> None:
        """Report the end of a step; ``done`` is the number of steps so far."""
        now = time.monotonic() if now is None else now
        self._times.append((now, done))
        while len(self._times) > 2 and now - self._times[0][0] > _WINDOW_S:
            self._times.popleft()
        interval = _TERMINAL_S if self._is_terminal else _LINES_S
        if self._active and (now - self._last >= interval or done == self._steps):
            self._last = now
            self._write(self._line(done, loss))

    def _line(self, done: int, loss: float) -> str:
        text = f"step {done}/{self._steps}, loss {loss:.4g}"
        (begin, first), (end, last) = self._times[0], self._times[-1]
        if end > begin and last > first:
            steps_per_s = (last - first) / (end - begin)
            text += f", {steps_per_s * self._clips:.3g} clips/s, {duration((self._steps - done) / steps_per_s)} left"
        return text

    def _write(self, line: str) -> None:
        if self._is_terminal:
            self._stream.write(f"\r{line.ljust(self._width)}")
            self._width = len(line)
        else:
            self._stream.write(f"{line}\n")
        self._stream.flush()

    def pause(self) -> None:
        """End the line that changes, before another message; work in between does not count in the rate."""
        if self._active and self._is_terminal and self._width:
            self._stream.write("\n")
            self._stream.flush()
            self._width = 0
        self._times.clear()

    def say(self, text: str) -> None:
        """Write a message in a line of its own."""
        if self._active:
            if self._is_terminal and self._width:
                self._stream.write("\n")
                self._width = 0
            self._stream.write(f"{text}\n")
            self._stream.flush()


def duration(seconds: float) -> str:
    """Return a duration in words."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min" if minutes else f"{seconds} s"
