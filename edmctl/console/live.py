"""Progress on a terminal, redrawn in place."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from typing import TYPE_CHECKING, TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from edmctl.console.progress import Pace, depth_words, has_pulses, phase_words
from edmctl.console.text import duration, percent

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.console.style import Style
    from edmctl.console.views import ProgressView, RatiosView

REDRAW_EVERY_S = 0.1
_BAR_WIDTH = 40
_CLASS_COLOUR = {"open": "bright_black", "normal": "green", "arc": "yellow", "short": "red"}


class LiveReporter:
    """Four lines that follow the job at 10 Hz of wall time and vanish when it ends."""

    def __init__(self, stream: TextIO, style: Style, clock: Callable[[], float] = time.monotonic) -> None:
        self._console = Console(
            file=stream, no_color=not style.colour, force_terminal=style.live, highlight=False
        )
        # Redrawing by hand: a refresh thread would touch the terminal while a signal handler writes to it.
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._pace = Pace(REDRAW_EVERY_S, clock)

    def progress(self, p: ProgressView) -> None:
        """Redraw when the last picture is a tenth of a second old or the phase is new."""
        if self._pace.is_due(p.phase):
            self._draw(draw_progress(p))

    def runs(self, done: int, total: int) -> None:
        """Redraw the count of runs."""
        self._draw(draw_runs(done, total))

    def note(self, text: str) -> None:
        """Print `text` above the picture, where it stays."""
        with suppress(OSError):
            self._console.print(Text(text, style="dim"))

    def close(self) -> None:
        """Take the picture away, and leave a line between the notes and the result."""
        if self._live.is_started:
            with suppress(OSError):
                self._live.stop()
                self._console.print()

    def _draw(self, picture: RenderableType) -> None:
        # A terminal that was closed must not stop a job; its SIGHUP does that in order.
        with suppress(OSError):
            if not self._live.is_started:
                self._live.start()
            self._live.update(picture, refresh=True)


def draw_progress(p: ProgressView) -> Group:
    """Draw depth, gap voltage, pulse classes and time as rich renderables."""
    rows = Table.grid(padding=(0, 2))
    if math.isfinite(p.depth_um):
        rows.add_row("depth", _depth_bar(p), depth_words(p))
    if has_pulses(p.ratios):
        rows.add_row("pulses", _class_bar(p.ratios), _class_words(p.ratios))
        rows.add_row("gap", _gap_bar(p), f"{p.gap_v:.1f} V, reference {p.reference_v:.1f} V")
    left = f", about {duration(p.time_left_s)} left" if p.time_left_s > 0 else ""
    head = Text.assemble((phase_words(p), "bold"), (f"  {duration(p.time_s)}{left}", "dim"))
    return Group(head, rows)


def draw_runs(done: int, total: int) -> Table:
    """Draw how many runs of many are done."""
    row = Table.grid(padding=(0, 2))
    row.add_row("runs", ProgressBar(total=total, completed=done, width=_BAR_WIDTH), f"{done} of {total}")
    return row


def _depth_bar(p: ProgressView) -> ProgressBar:
    known = math.isfinite(p.depth_um) and p.depth_target_um > 0.0
    share = min(max(p.depth_um / p.depth_target_um, 0.0), 1.0) if known else 0.0
    return ProgressBar(total=1.0, completed=share, width=_BAR_WIDTH)


def _class_bar(ratios: RatiosView) -> Text:
    bar, drawn, total = Text(), 0, 0.0
    for name, colour in _CLASS_COLOUR.items():
        total += float(getattr(ratios, name))
        cells = max(0, min(_BAR_WIDTH, round(total * _BAR_WIDTH)) - drawn)
        bar.append("━" * cells, style=colour)
        drawn += cells
    return bar.append(" " * (_BAR_WIDTH - drawn))


def _class_words(ratios: RatiosView) -> Text:
    words = Text()
    for name, colour in _CLASS_COLOUR.items():
        words.append(f"{percent(getattr(ratios, name), 0)} {name} ", style=colour)
    return words


def _gap_bar(p: ProgressView) -> Text:
    """A scale whose middle is the servo reference, so that left means too close and right too far."""
    full_v = 2 * max(p.reference_v, 1e-9)
    scale = ["─"] * _BAR_WIDTH
    scale[_BAR_WIDTH // 2] = "┼"
    if math.isfinite(p.gap_v):
        place = round(min(max(p.gap_v / full_v, 0.0), 1.0) * (_BAR_WIDTH - 1))
        scale[place] = "●"
    return Text("".join(scale), style="cyan")
