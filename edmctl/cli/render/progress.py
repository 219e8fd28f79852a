"""Progress for streams that cannot redraw: plain lines, JSON lines, or nothing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import TextIO

from edmctl.cli.render.result_table import render_ratios
from edmctl.dataclasses import fields
from edmctl.jsonout import render_json_line
from edmctl.labels import Basis, marked
from edmctl.results.progress import Progress
from edmctl.results.telemetry import PulseShares
from edmctl.wording import duration, escaped

PASSING_PHASE = "jumping"
"""Comes and goes every few seconds of machining, so it is not reported as a change."""
_IN_A_CUT = ("machining", PASSING_PHASE)
LINE_EVERY_S = 30.0
EVENT_EVERY_S = 1.0
_EVENT_KEYS = [field.name for field in fields(Progress) if field.name not in ("last_jump_s", "warned_s")]


class Reporter:
    """Watches a job, and shows nothing of it; the others show what their stream can."""

    def progress(self, p: Progress) -> None:
        """Take the newest state; called at 10 Hz or so of machine time."""

    def note(self, text: str) -> None:
        """Report an event once."""

    def runs(self, done: int, total: int) -> None:
        """Count finished runs of many."""

    def aside(self) -> None:
        """Make room for what is written past it."""

    def close(self) -> None:
        """Leave the terminal clean."""


class Pacer:
    """Estimates how long a series of runs still takes, from the runs since its start."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._begin: tuple[float, int, int] | None = None

    def time_left_s(self, done: int, total: int) -> float:
        """Return the time left; NaN until something is done."""
        now_s = self._clock()
        if self._begin is None or self._begin[2] != total or done < self._begin[1]:
            self._begin = (now_s, done, total)
        begin_s, begin_done, _ = self._begin
        made = done - begin_done
        return (now_s - begin_s) / made * (total - done) if made else math.nan


def left_words(time_left_s: float) -> str:
    """Return the time left in words; empty if it is unknown or over."""
    is_known = math.isfinite(time_left_s) and time_left_s >= 1.0
    return f", about {duration(time_left_s)} left" if is_known else ""


class _PacedReporter(Reporter):
    """Reports each change of phase, and otherwise once per `every_s` of wall time.

    A reader that leaves (`edmctl machine … 2>&1 | head`) silences it, and does not stop the job.
    """

    every_s: float

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream: TextIO | None = stream
        self._clock = clock
        self._phase = ""
        self._due_s = 0.0
        self._pacer = Pacer(clock)

    def _is_due(self, phase: str) -> bool:
        now_s = self._clock()
        if phase in (self._phase, PASSING_PHASE) and now_s < self._due_s:
            return False
        self._phase, self._due_s = phase, now_s + self.every_s
        return True

    def _write(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):
            self._stream = None


class LineReporter(_PacedReporter):
    """Plain lines, never a carriage return."""

    every_s = LINE_EVERY_S

    def progress(self, p: Progress) -> None:
        """Write a line when one is due."""
        if self._is_due(p.phase):
            self._write(progress_line(p) + "\n")

    def note(self, text: str) -> None:
        """Write `text` on a line of its own."""
        self._write(escaped(text) + "\n")

    def runs(self, done: int, total: int) -> None:
        """Write a line when one is due."""
        left_s = self._pacer.time_left_s(done, total)
        if self._is_due("runs") or done == total:
            self._write(f"{done} of {total} runs done{left_words(left_s)}\n")


class EventReporter(_PacedReporter):
    """JSON lines: each has the key `event`: `progress`, `runs` or `note`."""

    every_s = EVENT_EVERY_S

    def progress(self, p: Progress) -> None:
        """Write a `progress` object when one is due."""
        if self._is_due(p.phase):
            self._emit("progress", {key: getattr(p, key) for key in _EVENT_KEYS})

    def note(self, text: str) -> None:
        """Write a `note` object."""
        self._emit("note", {"text": text})

    def runs(self, done: int, total: int) -> None:
        """Write a `runs` object when one is due."""
        left_s = self._pacer.time_left_s(done, total)
        if self._is_due("runs"):
            self._emit("runs", {"done": done, "total": total, "time_left_s": left_s})

    def _emit(self, event: str, values: Mapping[str, object]) -> None:
        self._write(render_json_line({"event": event, **values}))


def progress_line(p: Progress) -> str:
    """Return the state in one line of plain text; gap, pulses and depth only while there are pulses."""
    parts = [f"{duration(p.time_s)}: {p.phase} {p.site}".rstrip()]
    if has_pulses(p.ratios):
        parts.append(f"gap {p.gap_v:.1f} V (reference {p.reference_v:.1f} V)")
        parts.append(render_ratios(p.ratios, decimals=0))
        if math.isfinite(p.depth_um):
            parts.append(f"depth {depth_words(p)}")
    if p.time_left_s > 0:
        parts.append(f"{duration(p.time_left_s)} left")
    return "; ".join(parts)


def depth_words(p: Progress) -> str:
    """Return the depth, and the target where it is a depth: a feed target has none."""
    u95 = f" ± {p.depth_u95_um:.1f}" if math.isfinite(p.depth_u95_um) else ""
    of_target = f" of {p.depth_target_um:.1f}" if math.isfinite(p.depth_target_um) else ""
    return f"{while_cutting(p)}{p.depth_um:.1f}{u95}{of_target} µm"


def while_cutting(p: Progress) -> str:
    """Return the mark of depth and wear in a cut: estimated, until the next touch."""
    return marked("", Basis.ESTIMATED) if p.phase in _IN_A_CUT else ""


def has_pulses(ratios: PulseShares) -> bool:
    """Say whether any pulse was counted: without one all shares are zero or unknown."""
    return ratios.open + ratios.normal + ratios.arc + ratios.short > 0.0
