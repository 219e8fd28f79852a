"""The report of a first start as text: item by item what was done, expected and read, and the likely mistakes."""

from __future__ import annotations

from edmctl.console.style import PLAIN, Ink, Style
from edmctl.results.first_start import FirstStartReport, Item, ItemStatus

_INKS = {
    ItemStatus.PASS: Ink.SIGNAL,
    ItemStatus.ANSWERED: Ink.FAINT,
    ItemStatus.FAIL: Ink.ERROR,
    ItemStatus.SKIPPED: Ink.WARNING,
    ItemStatus.ABSENT: Ink.FAINT,
}
_INDENT = 10


def render_first_start(report: FirstStartReport, style: Style = PLAIN) -> str:
    """Render every item under its part, and what it comes to."""
    lines, part = [f"First start of {report.machine}, {report.started}"], ""
    for item in report.items:
        if item.part != part:
            part = item.part
            lines += ["", style.paint(part, Ink.STRONG)]
        lines += _item(item, style)
    counts = [(status, sum(item.status is status for item in report.items)) for status in ItemStatus]
    lines += ["", f"{', '.join(f'{n} {status}' for status, n in counts if n)}."]
    if report.absent:
        absent = [f"{item.title} ({item.reason})" for item in report.items if item.key in report.absent]
        lines.append(f"Absent, not checked: {'; '.join(absent)}.")
    if report.ended:
        lines.append(f"Ended early: {report.ended}")
    if not report.complete:
        lines.append("Not complete: switch high voltage and amplifier off; the machine is not ready for use.")
    return "\n".join(lines)


def _item(item: Item, style: Style) -> list[str]:
    status = style.paint(f"{item.status:8}", _INKS[item.status])
    lines = [f"{status}  {item.title}{f': {item.reason}' if item.reason else ''}"]
    if item.read:
        lines += [f"{'':{_INDENT}}{name:10}{text}" for name, text in _told(item)]
    for cause in item.causes:
        nets = f"; net {', '.join(cause.nets)}" if cause.nets else ""
        lines.append(f"{'':{_INDENT}}{style.paint('likely    ', Ink.NOTE)}{cause.text}{nets}")
    return lines


def _told(item: Item) -> list[tuple[str, str]]:
    return [("done", item.done), ("expected", item.expected), ("read", item.read)]
