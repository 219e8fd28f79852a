"""Progress where a stream cannot redraw."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace

from edmctl.cli.render.progress import EventReporter, LineReporter, depth_words, progress_line
from edmctl.results.telemetry import PulseShares
from tests.cli.render.views import HandClock, made_state


class ClosedPipe(io.StringIO):
    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_lines_come_at_phase_changes_but_jumps_and_every_thirty_seconds() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = LineReporter(out, clock)
    for at_s, phase in (
        (1.0, "Z1"),
        (1.1, "Z1"),
        (2.0, "cut 1"),
        (3.0, "jumping"),
        (4.0, "cut 1"),
        (32.1, "cut 1"),
    ):
        clock.now_s = at_s
        reporter.progress(made_state(phase=phase, time_s=at_s))
    assert [line.split(":")[0] for line in out.getvalue().splitlines()] == ["1 s", "2 s", "32 s"]


def test_a_line_has_all_that_is_known() -> None:
    assert progress_line(made_state()) == (
        "2 min 05 s: approaching; gap 9.4 V (reference 9.6 V); 50 % open, 40 % normal, 2 % arc, 8 % short; "
        "depth 42.2 of 180.0 µm; 8 min 00 s left"
    )
    idle = made_state(phase="moving", ratios=PulseShares(0.0, 0.0, 0.0, 0.0), time_left_s=math.nan)
    assert progress_line(idle) == "2 min 05 s: moving"
    assert "; depth 42.2 µm;" in progress_line(made_state(depth_target_um=math.nan))
    known = progress_line(made_state(depth_u95_um=2.34, site="grid-4"))
    assert "approaching grid-4" in known
    assert "± 2.3 of" in known
    cutting, touching = made_state(phase="machining"), made_state(phase="measuring")
    assert depth_words(cutting) == f"~{depth_words(touching)}"


def test_notes_are_lines_until_the_reader_leaves() -> None:
    out = io.StringIO()
    LineReporter(out, HandClock()).note("Z1 = 53.10 µm")
    assert out.getvalue() == "Z1 = 53.10 µm\n"
    gone = LineReporter(ClosedPipe(), HandClock())
    gone.note("one")
    gone.note("two")


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


def test_runs_are_counted_at_most_every_thirty_seconds() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = LineReporter(out, clock)
    for done in range(4):
        reporter.runs(done, 40)
        clock.now_s += 20.0
    assert out.getvalue() == "0 of 40 runs done\n2 of 40 runs done, about 12 min 40 s left\n"
