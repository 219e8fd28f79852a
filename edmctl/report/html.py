"""Elements of every page: one HTML file that needs nothing but itself, with tables, figures and sections."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from edmctl.dataclasses import dataclass
from edmctl.report.panels import NothingToDraw, house_style, rendered

WIDE_MM = 120.0
"""Figures wider than this take both columns of the page."""
PX_PER_MM = 96.0 / 25.4
MOST_SVG_BYTES = 200_000
"""A figure with more in it goes into the page as PNG, so that no page grows beyond a few megabytes."""


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table. The first column names its rows; `words`: the others contain words, not numbers."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    words: bool = False


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of a page, or why there is none. It is rendered last, when all that the page needs has been read.

    name : of its element, once a page; sees : its caption; datasets : sources of its data
    """

    name: str
    title: str
    sees: str
    figure: Figure | None = None
    why_not: str = ""
    datasets: tuple[str, ...] = ()

    def address(self) -> str:
        """Return the rendered figure as a data URI."""
        assert self.figure is not None
        # Letters as outlines: the page looks the same where the font of the figures is not installed.
        with house_style(), rc_context({"svg.fonttype": "path"}):
            media_type, content = "image/svg+xml", rendered(self.figure, ".svg")
            if len(content) > MOST_SVG_BYTES:
                media_type, content = "image/png", rendered(self.figure, ".png")
        return f"data:{media_type};base64,{base64.b64encode(content).decode()}"


def picture_of(
    name: str,
    title: str,
    sees: str,
    make: Callable[[], Figure],
    datasets: tuple[str, ...] = (),
    *,
    formulas: bool = True,
) -> Picture:
    """Draw a figure for a page: `make` returns it, or raises NothingToDraw.

    formulas : dollars in its texts enclose formulas; False if it has names that people choose
    """
    with house_style(), rc_context({"text.parse_math": formulas}):
        try:
            return Picture(name, title, sees, make(), datasets=datasets)
        except NothingToDraw as reason:
            return Picture(name, title, sees, why_not=str(reason))


def document(
    title: str, header: Iterable[str], contents: Iterable[tuple[str, str]], body: Iterable[str], footer: str
) -> str:
    """Return the whole page.

    header : elements below the title's line; contents : names of sections and the texts of their links
    """
    style = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    links = "".join(f'<a href="#{name}">{escape(heading)}</a>' for name, heading in contents)
    newline = "\n"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="edmctl">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{style}</style>
</head>
<body>
<header>
{newline.join(header)}
<nav>{links}</nav>
</header>
<main>
{newline.join(body)}
</main>
<footer>{paragraph(footer)}</footer>
</body>
</html>
"""


def section(name: str, heading: str, parts: Iterable[PageTable | str | None]) -> str:
    """Return a section of elements and tables; empty ones are left out."""
    inside = [part if isinstance(part, str) else table(part) for part in parts if part]
    lines = [f'<section id="{name}">', f"<h2>{escape(heading)}</h2>", *filter(None, inside), "</section>"]
    return "\n".join(lines)


def tiles(numbers: Iterable[tuple[str, str, str]]) -> str:
    """Return the few most important numbers: name, value and remark."""
    shown = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(more)}</small></dd></div>"
        for name, value, more in numbers
    )
    return f'<dl class="tiles">{shown}</dl>' if shown else ""


def figures(pictures: Sequence[Picture], first: int = 1) -> list[str]:
    """Return figures with their captions, numbered from `first` on, then why others were not drawn."""
    drawn = [picture for picture in pictures if picture.figure is not None]
    reasons = "".join(
        f"<li>{escape(picture.title)}: {_prose(picture.why_not)}</li>"
        for picture in pictures
        if picture.figure is None
    )
    parts = []
    if drawn:
        parts += ['<div class="figures">', *(_figure(n, p) for n, p in enumerate(drawn, first)), "</div>"]
    if reasons:
        parts.append(f'<details class="absent"><summary>Not drawn</summary>\n<ul>{reasons}</ul>\n</details>')
    return parts


def _figure(number: int, picture: Picture) -> str:
    assert picture.figure is not None
    address = picture.address()
    width_mm, height_mm = (25.4 * inches for inches in picture.figure.get_size_inches())
    wide = ' class="wide"' if width_mm > WIDE_MM else ""
    width, height = (round(mm * PX_PER_MM) for mm in (width_mm, height_mm))
    alt = escape(picture.sees.replace("`", ""))
    source = ", ".join(f"<code>{path}</code>" for path in picture.datasets)
    return (
        f'<figure id="{picture.name}"{wide}><img src="{address}" width="{width}" height="{height}" '
        f'alt="{alt}">\n<figcaption><b>Fig. {number}: {escape(picture.title)}.</b> {_prose(picture.sees)}'
        f"{f' From {source}.' if source else ''}</figcaption></figure>"
    )


def folded(summary: str, inside: str) -> str:
    """Return an element that a click on its summary opens."""
    return f"<details><summary>{escape(summary)}</summary>\n{inside}\n</details>"


def sentences(lines: Iterable[str]) -> str:
    """Return a list of sentences; empty without any."""
    items = "".join(f"<li>{_prose(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def table(made: PageTable) -> str:
    """Return a table that scrolls where it is too wide; empty without rows."""
    if not made.rows:
        return ""
    caption = f"<caption>{escape(made.caption)}</caption>" if made.caption else ""
    cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in made.header)
    header = f"<thead><tr>{cells}</tr></thead>" if any(made.header) else ""
    rows = []
    for row in made.rows:
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        rows.append(f'<tr><th scope="row">{escape(row[0])}</th>{cells}</tr>')
    body = "\n".join(rows)
    note = f'\n<p class="note">{_prose(made.note)}</p>' if made.note else ""
    return (
        f'<div class="scroll" tabindex="0" role="group" aria-label="{escape(made.caption or "table")}">'
        f'<table class="{"words" if made.words else "numbers"}">{caption}{header}'
        f"<tbody>\n{body}\n</tbody></table></div>{note}"
    )


def paragraph(text: str, name: str = "") -> str:
    """Return a paragraph, of a class of the style sheet."""
    return f'<p class="{name}">{_prose(text)}</p>' if name else f"<p>{_prose(text)}</p>"


def _prose(text: str) -> str:
    """Return text for HTML; text between backticks is code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", escape(text))
