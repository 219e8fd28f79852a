"""Images and boards as text."""

from __future__ import annotations

from edmctl.console.layout import render_columns
from edmctl.console.style import PLAIN, Style
from edmctl.results.firmware import BoardFacts, ImageFacts, dotted, hexadecimal, settings_text


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
