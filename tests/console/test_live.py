"""The picture on a terminal."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import pytest
from rich.console import Console

from edmctl.console.live import LiveReporter, draw_progress
from edmctl.console.style import Style
from tests.console.views import Ratios, State


def drawn(state: State) -> str:
    console = Console(file=io.StringIO(), width=100, force_terminal=True, no_color=True, highlight=False)
    with console.capture() as capture:
        console.print(draw_progress(state))
    return capture.get()


def test_phase_depth_gap_ratios_and_time_are_shown() -> None:
    picture = drawn(State())
    for part in ("cut 1", "2 min 05 s", "8 min 00 s left", "42.2 of 180.0 µm", "9.4 V, reference 9.6 V"):
        assert part in picture
    assert "50 % open 40 % normal 2 % arc 8 % short" in picture


def test_a_procedure_without_a_depth_shows_none() -> None:
    picture = drawn(State(depth_um=math.nan, ratios=Ratios(0.0, 0.0, 0.0, 0.0)))
    assert "depth" not in picture
    assert "8 min 00 s left" in picture


def test_the_mark_is_left_of_the_middle_when_the_gap_is_too_close() -> None:
    def mark(gap_v: float) -> int:
        line = next(row for row in drawn(State(gap_v=gap_v)).splitlines() if "reference" in row)
        return line.index("●")

    assert mark(4.0) < mark(9.6) < mark(12.0)


@pytest.mark.parametrize(
    "state",
    [
        State(gap_v=math.nan, time_left_s=math.nan, depth_um=math.nan),
        State(reference_v=0.0, depth_target_um=0.0),
        State(depth_target_um=math.nan),
        State(ratios=Ratios(math.nan, math.nan, math.nan, math.nan)),
        State(depth_um=999.0, gap_v=99.0, ratios=Ratios(1.0, 0.0, 0.0, 0.0)),
    ],
)
def test_odd_values_do_not_break_the_picture(state: State) -> None:
    assert "cut 1" in drawn(state)


def test_a_closed_terminal_does_not_stop_the_job() -> None:
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(5, "Input/output error")

    reporter = LiveReporter(Closed(), Style(colour=False, live=True), clock=lambda: 0.0)
    reporter.note("Z1 done")
    reporter.progress(State())
    reporter.runs(1, 2)
    reporter.close()


def test_the_picture_vanishes_and_notes_stay() -> None:
    out = io.StringIO()
    reporter = LiveReporter(out, Style(colour=False, live=True), clock=lambda: 0.0)
    reporter.progress(State())
    reporter.note("Z1 done")
    reporter.close()
    text = out.getvalue()
    assert "Z1 done" in text
    assert text.endswith("\x1b[2K") or "\x1b[1A" in text
    assert replace(State()).phase in text
