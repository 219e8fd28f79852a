"""Progress where a stream cannot redraw."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace

from edmctl.cli.render.progress import EventReporter, LineReporter, depth_words, progress_line
from edmctl.results.telemetry import PulseShares
from tests.cli.render.views import made_state


class HandClock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class ClosedPipe(io.StringIO):
    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_lines_come_at_phase_changes_and_every_thirty_seconds() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = LineReporter(out, clock)
    for elapsed_s, phase in ((0.0, "Z1"), (0.1, "Z1"), (0.2, "cut 1"), (30.1, "cut 1"), (30.3, "cut 1")):
        clock.now_s = 100.0 + elapsed_s
        reporter.progress(made_state(phase=phase, time_s=elapsed_s))
    assert [line.split(":")[0] for line in out.getvalue().splitlines()] == ["0 s", "0 s", "30 s"]


def test_a_line_says_it_all_without_control_characters() -> None:
    out = io.StringIO()
    LineReporter(out, HandClock()).progress(made_state())
    assert out.getvalue() == (
        "2 min 05 s: approaching; gap 9.4 V (reference 9.6 V); 50 % open, 40 % normal, 2 % arc, 8 % short; "
        "depth 42.2 of 180.0 µm; 8 min 00 s left\n"
    )


def test_notes_are_lines() -> None:
    out = io.StringIO()
    LineReporter(out, HandClock()).note("Z1 = 53.10 µm")
    assert out.getvalue() == "Z1 = 53.10 µm\n"


def test_events_are_json_lines() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = EventReporter(out, clock)
    reporter.progress(made_state())
    reporter.note("Z1 done")
    reporter.progress(made_state())
    clock.now_s += 1.1
    reporter.progress(replace(made_state(), time_left_s=math.nan))
    events = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [e["event"] for e in events] == ["progress", "note", "progress"]
    assert events[0]["gap_v"] == 9.4
    assert events[0]["ratios"] == {"open": 0.5, "normal": 0.4, "arc": 0.02, "short": 0.08}
    assert events[1]["text"] == "Z1 done"
    assert events[2]["time_left_s"] is None


def test_a_reader_that_left_silences_the_reporter() -> None:
    reporter = LineReporter(ClosedPipe(), HandClock())
    reporter.note("one")
    reporter.note("two")


def test_without_pulses_the_phase_says_it_all() -> None:
    out = io.StringIO()
    idle = made_state(phase="moving", ratios=PulseShares(0.0, 0.0, 0.0, 0.0), time_left_s=math.nan)
    LineReporter(out, HandClock()).progress(idle)
    assert out.getvalue() == "2 min 05 s: moving\n"


def test_jumps_are_no_news() -> None:
    out = io.StringIO()
    reporter = LineReporter(out, HandClock())
    for phase in ("machining", "jumping", "machining", "jumping", "measuring"):
        reporter.progress(made_state(phase=phase))
    assert [line.split(";")[0] for line in out.getvalue().splitlines()] == [
        "2 min 05 s: machining",
        "2 min 05 s: measuring",
    ]


def test_runs_are_counted_at_most_every_thirty_seconds() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = LineReporter(out, clock)
    for done in range(4):
        reporter.runs(done, 40)
        clock.now_s += 20.0
    assert out.getvalue() == "0 of 40 runs done\n2 of 40 runs done, about 12 min 40 s left\n"


def test_a_feed_target_has_no_depth_to_reach() -> None:
    out = io.StringIO()
    LineReporter(out, HandClock()).progress(made_state(depth_target_um=math.nan))
    assert "; depth 42.2 µm;" in out.getvalue()


def test_the_uncertainty_and_the_place_are_told_where_they_are_known() -> None:
    line = progress_line(replace(made_state(), depth_u95_um=2.34, site="grid-4"))
    assert "approaching grid-4" in line
    assert "± 2.3 of" in line
    assert "±" not in progress_line(made_state())


def test_depth_and_wear_in_a_cut_are_estimates_and_say_so() -> None:
    cutting, touching = made_state(phase="machining"), made_state(phase="measuring")
    assert depth_words(cutting) == f"~{depth_words(touching)}"
