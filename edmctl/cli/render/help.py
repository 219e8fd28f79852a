"""Help of commands: sections with whole sentences at any width, on a terminal in panels."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from edmctl.cli.render.terminal import Ink, Style, terminal_columns, wrapped

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_COLUMNS = 110
LEAST_TEXT = 32
"""If there are fewer columns beside the options, their texts are below them."""
LONGEST_LABEL = 30
"""The value of an option with a longer label is on a line of its own."""

KEPT_INDENT = 6
"""Of further lines of a line that is kept as it is, such as an exit code with its meaning."""

Row = tuple[str, str]


def render_help(command: Any, context: Any, style: Style) -> str:
    """Render usage, description, arguments, options, commands and epilog of a click command.

    The help of typer itself (0.28) cuts words at 40 columns, keeps the line breaks of docstrings, and writes to
    stdout even if the help belongs on stderr.
    """
    from rich.text import Text

    columns = min(terminal_columns(), MOST_COLUMNS)
    records: dict[str, list[Row]] = {"Arguments": [], "Options": []}
    for parameter in command.get_params(context):
        if record := parameter.get_help_record(context):
            kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
            records[kind].append(record)
    if hasattr(command, "list_commands"):
        inner = [command.get_command(context, name) for name in command.list_commands(context)]
        records["Commands"] = [(one.name, one.short_help) for one in inner if not one.hidden]
    usage = " ".join(command.collect_usage_pieces(context))
    parts: list[RenderableType] = [
        Text.assemble("Usage: ", (context.command_path, Ink.STRONG), f" {usage}"),
        *_paragraphs(command.help, columns),
    ]
    for title, rows in records.items():
        parts += _section(title, rows, style, columns)
    parts += _paragraphs(command.epilog, columns)
    return Style(style.colour, style.live, style.unicode, columns).render(*parts)


def _paragraphs(text: str | None, columns: int) -> Iterator[RenderableType]:
    """Each paragraph after an empty line; the lines of one that begins with a backspace stay as they are."""
    from rich.text import Text

    for paragraph in filter(None, inspect.cleandoc(text or "").split("\n\n")):
        yield Text()
        if paragraph.startswith("\b"):
            for line in paragraph.splitlines()[1:]:
                yield Text("\n".join(wrapped(line, columns, " " * KEPT_INDENT)))
        else:
            yield Text(" ".join(paragraph.split()), overflow="fold")


def _section(title: str, rows: Sequence[Row], style: Style, columns: int) -> Iterable[RenderableType]:
    """A panel on a terminal, else a heading with its rows below."""
    from rich.padding import Padding
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    if not rows:
        return ()
    labels = [_label(label) for label, _ in rows]
    widest = max(len(line) for label in labels for line in label.split("\n"))
    table = Table.grid(padding=(0, 2, 0, 0))
    if columns - widest - 6 < LEAST_TEXT:
        for label, text in rows:
            table.add_row(Text(label, style=Ink.NOTE, overflow="fold"))
            table.add_row(Padding(Text(text, overflow="fold"), (0, 0, 0, 4)))
    else:
        table.add_column(no_wrap=True, style=Ink.NOTE)
        table.add_column(ratio=1, overflow="fold")
        for label, (_, text) in zip(labels, rows, strict=True):
            table.add_row(Text(label), Text(text))
    if style.live and style.unicode:
        return (Text(), Panel(table, title=title, title_align="left", border_style=Ink.FAINT))
    return (Text(f"\n{title}:"), Padding(table, (0, 0, 0, 2)))


def _label(label: str) -> str:
    """Return an option and its value, the value on a line of its own if both are long."""
    name, _, value = label.rpartition(" ")
    return f"{name}\n    {value}" if name and len(label) > LONGEST_LABEL else label
