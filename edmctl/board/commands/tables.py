"""Tables of images, boards, and of the first start."""

from __future__ import annotations

from edmctl.board.results import (
    BoardFacts,
    FirstStartReport,
    ImageFacts,
    Item,
    ItemStatus,
    hexadecimal,
    settings_text,
)
from edmctl.cli.render.terminal import PLAIN, Ink, Style, render_columns
from edmctl.wording import dotted

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
    told = (("done", item.done), ("expected", item.expected), ("read", item.read))
    if item.read:
        lines += [f"{'':{_INDENT}}{name:10}{text}" for name, text in told]
    for cause in item.causes:
        nets = f"; net {', '.join(cause.nets)}" if cause.nets else ""
        lines.append(f"{'':{_INDENT}}{style.paint('likely    ', Ink.NOTE)}{cause.text}{nets}")
    return lines


def render_image(image: ImageFacts, style: Style = PLAIN) -> str:
    """Render what an image is, and of an ELF what takes its memories."""
    same = "that of this edmctl" if image.has_same_schema else "another one than this edmctl's"
    rows = [
        ("image", f"{image.path} ({image.kind}), whole"),
        ("board", f"{image.board_name} (board {image.board})"),
        ("firmware", dotted(image.firmware)),
        ("protocol", dotted(image.protocol)),
        ("schema", f"{hexadecimal(image.schema_hash)}, {same}"),
        ("size", f"{image.size_bytes} bytes"),
        ("CRC-32", hexadecimal(image.crc32)),
        ("settings", settings_text(image.settings)),
    ]
    parts = [_pairs(rows)]
    if image.sections:
        table = [
            (s.name, hexadecimal(s.address), str(s.size_bytes), " and ".join(s.memories))
            for s in image.sections
        ]
        parts.append(render_columns(("section", "address", "bytes", "memory"), table, style, "<>><"))
        used = image.used_bytes()
        parts.append(", ".join(f"{memory} {used[memory]} bytes" for memory in used))
    return "\n\n".join(parts)


def render_board(board: BoardFacts) -> str:
    """Render what a controller says of itself."""
    same = "that of this edmctl" if board.has_same_schema else "another one than this edmctl's"
    rows = [
        ("port", board.port),
        ("controller", board.serial or "it does not tell its number"),
        ("board", "it does not tell" if board.board is None else f"{board.board_name} (board {board.board})"),
        ("firmware", dotted(board.firmware) if board.firmware else "it does not tell"),
        ("protocol", dotted(board.protocol)),
        ("schema", f"{hexadecimal(board.schema_hash)}, {same}"),
    ]
    if board.differing:
        rows.append(("differing", ", ".join(board.differing)))
    if board.state is not None:
        fault = f", fault {board.fault} is latched" if board.fault else ""
        rows.append(("state", f"{board.state}{fault}"))
    if board.boot_count is not None:
        rows.append(("boots", str(board.boot_count)))
    return _pairs(rows)


def _pairs(rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {text}" for name, text in rows)
