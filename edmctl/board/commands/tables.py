"""Tables of images, boards, and of the first start."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.board.board_firmware import BoardFacts
from edmctl.board.image import Image, hexadecimal
from edmctl.board.settings import settings_text
from edmctl.cli.render.terminal import PLAIN, Ink, Style
from edmctl.wording import dotted

if TYPE_CHECKING:
    from edmctl.board.first_start.checklist import FirstStartReport, Item

_INKS = {
    "pass": Ink.SIGNAL,
    "answered": Ink.FAINT,
    "fail": Ink.ERROR,
    "skipped": Ink.WARNING,
    "absent": Ink.FAINT,
}


def render_first_start(report: FirstStartReport, style: Style = PLAIN) -> str:
    """Render every item under its part, and a summary."""
    lines, part = [f"First start of {report.machine}, {report.started}"], ""
    for item in report.items:
        if item.part != part:
            part = item.part
            lines += ["", style.paint(part, Ink.STRONG)]
        lines += _item(item, style)
    counts = [(status, sum(item.status == status for item in report.items)) for status in _INKS]
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
    lines = [f"{status}  {item.title}{item.reason and ': '}{item.reason}"]
    if item.read:
        rows = (("done", item.done), ("expected", item.expected), ("read", item.read))
        lines += [f"{'':10}{name:10}{text}" for name, text in rows]
    for cause in item.causes:
        nets = f"; net {', '.join(cause.nets)}" if cause.nets else ""
        lines.append(f"{'':10}{style.paint('likely    ', Ink.NOTE)}{cause.text}{nets}")
    return lines


def render_image(image: Image) -> str:
    """Render what an image is, and of an ELF the memory that it takes."""
    record, used = image.record, image.used_bytes()
    rows = [
        ("image", f"{image.path} ({image.kind}), whole"),
        ("board", f"{image.board_name} (board {record.board})"),
        ("firmware", dotted(record.firmware)),
        ("protocol", dotted(record.protocol)),
        ("schema", _schema(record.schema_hash, is_same=image.has_same_schema)),
        ("size", f"{record.size_bytes} bytes"),
        ("CRC-32", hexadecimal(record.crc32)),
        ("settings", settings_text(image.settings)),
    ]
    if used:
        rows.append(("memory", ", ".join(f"{memory} {size} bytes" for memory, size in used.items())))
    return _pairs(rows)


def render_board(board: BoardFacts) -> str:
    """Render what a controller reports."""
    unknown = "not reported"
    rows = [
        ("port", board.port),
        ("controller", board.serial or unknown),
        ("board", unknown if board.board is None else f"{board.board_name} (board {board.board})"),
        ("firmware", dotted(board.firmware) if board.firmware else unknown),
        ("protocol", dotted(board.protocol)),
        ("schema", _schema(board.schema, is_same=board.has_same_schema)),
    ]
    if board.differing:
        rows.append(("differing", ", ".join(board.differing)))
    if board.state is not None:
        fault = f", fault {board.fault} is latched" if board.fault else ""
        rows.append(("state", f"{board.state}{fault}"))
    if board.boot_count is not None:
        rows.append(("boots", str(board.boot_count)))
    return _pairs(rows)


def _schema(number: int, *, is_same: bool) -> str:
    return f"{hexadecimal(number)}, {'that' if is_same else 'not that'} of this edmctl"


def _pairs(rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {text}" for name, text in rows)
