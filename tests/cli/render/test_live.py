"""The picture on a terminal: what it shows, where it fits, and what it leaves behind; bars."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace

import pytest
from rich.cells import cell_len

from edmctl.cli.render.live import LiveReporter, count_bar, depth_bar, draw_view, pulse_bar
from edmctl.cli.render.terminal import Span, Style
from edmctl.results.progress import Progress
from edmctl.results.telemetry import PulseShares
from tests.cli.render.views import HandClock, made_state

PLAIN_VIEW = Style(colour=False, live=True)
ASCII_VIEW = Style(colour=False, live=True, unicode=False)
FULL = made_state(
    phase="machining",
    site="hole-4",
    step="cut 2",
    depth_u95_um=1.2,
    wear_um=24.5,
    wear_u95_um=1.3,
    feed_um=66.7,
    feed_um_s=0.31,
    jumps=12,
    jump_period_s=10.0,
    last_jump_s=121.0,
    sites_done=3,
    sites_total=9,
    warning="27 % arcs in the last 2 s; the limit is 20 %.",
    warned_s=111.0,
)
NO_PULSES = PulseShares(0.0, 0.0, 0.0, 0.0)


class Writes(io.StringIO):
    """Keeps each write apart."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []

    def write(self, text: str) -> int:
        self.parts.append(text)
        return super().write(text)


def drawn(state: Progress, width: int = 100, height: int = 40, style: Style = PLAIN_VIEW) -> str:
    return "\n".join(text for text, _ in draw_view(state, width, height, style))


def text_of(spans: list[Span]) -> str:
    return "".join(text for text, _ in spans)


def test_everything_that_is_known_is_shown() -> None:
    picture = drawn(FULL)
    for part in (
        "machining hole-4, cut 2, 3 of 9 done",
        "2 min 05 s, about 8 min 00 s left",
        "42.2 ± 1.2 of 180.0 µm",
        "50 % open, 40 % normal, 2 % arc, 8 % short",
        "9.4 V, reference 9.6 V",
        "at 110.0 µm",
        "66.7 µm, 0.31 µm/s, tool wear ~24.5 ± 1.3 µm",
        "12 in this cut, every 10 s, the last 4 s ago",
        "warning 14 s ago: 27 % arcs",
    ):
        assert part in picture
    assert "\x1b" not in picture
    assert ("█" in picture, "█" in drawn(FULL, 60)) == (True, False)
    assert "\x1b[94m" in drawn(FULL, style=Style(colour=True, live=True))


def test_a_depth_is_shown_where_the_target_is_one() -> None:
    assert "depth" not in drawn(made_state(depth_um=math.nan, ratios=NO_PULSES))
    fed = drawn(replace(FULL, feed_target_um=250.0, depth_target_um=math.nan))
    assert "66.7 of 250.0 µm" in fed
    assert "depth" not in fed


@pytest.mark.parametrize("style", [PLAIN_VIEW, ASCII_VIEW, Style(colour=True, live=True)])
@pytest.mark.parametrize("width", [1, 5, 12, 30, 59, 60, 79, 80, 98, 99, 120, 199])
def test_no_line_is_wider_than_the_terminal(width: int, style: Style) -> None:
    long = replace(FULL, site="a-rather-long-name-of-a-hole-" * 4, warning="长" * 150)
    for height in (1, 3, 8, 12, 40):
        lines = draw_view(long, width, height, style)
        assert 1 <= len(lines) <= height
        for text, cells in lines:
            assert cell_len(re.sub(r"\x1b\[[0-9;]*m", "", text)) == cells <= width


def test_what_matters_most_is_kept() -> None:
    assert "machining" in drawn(FULL, height=1)
    three = drawn(FULL, height=3)
    assert "42.2 ± 1.2" in three
    assert "warning" in three
    assert "jumps" not in three
    line = drawn(replace(FULL, site="x" * 100), width=79, height=1)
    assert line.endswith("2 min 05 s, about 8 min 00 s left")
    assert "x…" in line
    assert "\x1b" not in drawn(replace(FULL, site="a\x1b[2Jb", warning="c\rd"))


def test_a_terminal_without_unicode_gets_figures_in_ascii() -> None:
    picture = drawn(FULL, style=ASCII_VIEW)
    assert picture.isascii()
    assert "42.2 +- 1.2 of 180.0 um" in picture
    out = io.StringIO()
    reporter = LiveReporter(out, ASCII_VIEW)
    reporter.note("Z1 = 53.10 µm ± 0.1")
    reporter.runs(1, 2)
    assert out.getvalue().startswith("Z1 = 53.10 um +- 0.1\n")
    assert out.getvalue().isascii()


@pytest.mark.parametrize(
    "state",
    [
        made_state(gap_v=math.nan, time_left_s=math.nan, depth_um=math.nan),
        made_state(reference_v=0.0, depth_target_um=0.0),
        made_state(depth_target_um=math.nan),
        made_state(ratios=PulseShares(math.nan, math.nan, math.nan, math.nan)),
        made_state(depth_um=999.0, gap_v=99.0, ratios=PulseShares(1.0, 0.0, 0.0, 0.0)),
        made_state(depth_um=-5.0, depth_u95_um=400.0),
        made_state(time_s=math.nan),
        made_state(displacement_um=math.nan, jumps=3, time_left_s=math.inf),
    ],
)
def test_odd_values_do_not_break_the_picture(state: Progress) -> None:
    assert "approaching" in drawn(state)


def test_a_closed_terminal_does_not_stop_the_job() -> None:
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(5, "Input/output error")

    reporter = LiveReporter(Closed(), PLAIN_VIEW, clock=lambda: 0.0)
    reporter.note("Z1 done")
    reporter.progress(made_state())
    reporter.runs(1, 2)
    reporter.close()


def erased(rows: int) -> str:
    """What goes to the begin of a block of so many rows, and blanks them one by one."""
    up = f"\r\x1b[{rows - 1}A"
    return up + "\x1b[2K\x1b[B" * (rows - 1) + "\x1b[2K" + up


def test_the_picture_vanishes_notes_stay_and_the_cursor_is_back() -> None:
    out, clock = io.StringIO(), HandClock()
    reporter = LiveReporter(out, PLAIN_VIEW, clock)
    reporter.progress(made_state())
    reporter.note("Z1 done")
    reporter.aside()
    text = out.getvalue()
    assert text.startswith("\x1b[?2026h\x1b[?25l")
    assert f"{erased(6)}Z1 done\n" in text
    assert text.endswith(f"{erased(6)}\x1b[?25h")
    reporter.close()  # there is no picture: nothing to take away
    assert out.getvalue() == text
    clock.now_s += 1.0
    reporter.progress(made_state())
    assert "\x1b[?25l\r" in out.getvalue()[len(text) :]
    reporter.close()
    assert out.getvalue().endswith(f"{erased(6)}\x1b[?25h\n")


def test_every_picture_is_one_write_that_blanks_nothing() -> None:
    out, clock = Writes(), HandClock()
    reporter = LiveReporter(out, PLAIN_VIEW, clock)
    for depth_um in (42.0, 43.0):
        reporter.progress(replace(FULL, depth_um=depth_um))
    assert len(out.parts) == 1
    clock.now_s += 0.1
    reporter.progress(replace(FULL, depth_um=44.0))
    first, again = out.parts
    assert ("~42.0 ±" in first, "~44.0 ±" in again) == (True, True)
    assert again.count("\x1b[J") == 1
    assert again.index("jumps") < again.index("\x1b[J")


def test_a_narrower_terminal_is_cleared_of_what_it_wrapped(monkeypatch: pytest.MonkeyPatch) -> None:
    out, clock, width = Writes(), HandClock(), 80
    reporter = LiveReporter(out, PLAIN_VIEW, clock)
    monkeypatch.setattr("edmctl.cli.render.live.Screen.size", lambda _: (width, 40))
    reporter.progress(FULL)
    first = out.parts[0].split("\r")[1]
    rows = [len(re.sub(r"\x1b\[[?0-9;]*[a-zA-Z]", "", line)) for line in first.split("\n")]
    width = 40
    clock.now_s += 0.1
    reporter.progress(FULL)
    wrapped = sum(max(1, math.ceil(cells / 40)) for cells in rows)
    assert wrapped > len(rows)
    assert f"\r\x1b[{wrapped - math.ceil(rows[-1] / 40)}A\x1b[2K" in out.parts[1]
    assert f"\x1b[2K\r\x1b[{wrapped - 1}A" in out.parts[1]


def test_runs_are_counted_in_a_bar() -> None:
    out = io.StringIO()
    reporter = LiveReporter(out, PLAIN_VIEW, HandClock())
    for done in (1, 2, 40):
        reporter.runs(done, 40)
    assert [f"{done} of 40" in out.getvalue() for done in (1, 2, 40)] == [True, False, True]


@pytest.mark.parametrize(
    ("done_um", "u95_um", "bar"),
    [
        (0.0, math.nan, "─" * 26 + "│─"),
        (50.0, math.nan, "█" * 13 + "─" * 13 + "│─"),
        (50.0, 8.0, "█" * 10 + "▒" * 6 + "─" * 10 + "│─"),
        (50.0, 0.01, "█" * 12 + "▒" + "─" * 13 + "│─"),
        (100.0, 1.0, "█" * 25 + "▒│─"),
        (500.0, 1.0, "█" * 26 + "│█"),
    ],
)
def test_the_depth_bar_shows_depth_interval_and_target(done_um: float, u95_um: float, bar: str) -> None:
    assert text_of(depth_bar(done_um, u95_um, 100.0, 28)) == bar


def test_bars_of_shares_and_counts() -> None:
    assert text_of(depth_bar(50.0, 1.0, math.nan, 10)) == "─" * 10
    assert [text_of(count_bar(done, 4, 4)) for done in (0, 1, 4)] == ["────", "█───", "████"]
    ratios = PulseShares(0.5, 0.3, 0.1, 0.1)
    assert text_of(pulse_bar(ratios, 20, colour=False)) == "░" * 10 + "█" * 6 + "▓▓▞▞"
    assert text_of(pulse_bar(ratios, 20)) == "█" * 20
