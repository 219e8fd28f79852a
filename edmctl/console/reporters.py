"""Which reporter suits a stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, TextIO

from edmctl.console.progress import EventReporter, LineReporter, QuietReporter, Reporter

if TYPE_CHECKING:
    from edmctl.console.style import Style


def reporter_for(stream: TextIO, style: Style, *, events: bool, quiet: bool) -> Reporter:
    """JSON lines when asked for, else silence when asked for, else the best that `stream` can show."""
    if events:
        return EventReporter(stream)
    if quiet:
        return QuietReporter()
    if style.live:
        from edmctl.console.live import LiveReporter

        return LiveReporter(stream, style)
    return LineReporter(stream)
