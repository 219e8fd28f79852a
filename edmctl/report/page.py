"""One page with all there is to know of a run: HTML that needs nothing but itself, no script and no network."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.labels import marked, weakest
from edmctl.record.results import estimated_depth
from edmctl.report import page_tables
from edmctl.report.kinds import KINDS, Kind, draw
from edmctl.report.numbers import numbers_of, target_depths_um
from edmctl.report.style import NothingToDraw, house_style, rendered
from edmctl.wording import (
    TIP,
    UNKNOWN,
    about,
    count,
    decimal,
    duration,
    percent,
    plain_number,
    removal_rate,
    with_u95,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile
    from edmctl.report.numbers import RunNumbers
    from edmctl.report.page_tables import PageTable
    from edmctl.results.run_file import Sentence

NARROW = "\u202f"
"""A narrow space that a line does not break."""
WIDE_MM = 120.0
"""Figures wider than this take both columns of the page."""
PX_PER_MM = 96.0 / 25.4

_CONTENTS = (
    ("wanted", "Wanted"),
    ("numbers", "Numbers"),
    ("figures", "Figures"),
    ("story", "What happened"),
    ("source", "Machine and versions"),
)
_HEADINGS = dict(_CONTENTS)

MOST_SVG_BYTES = 200_000
"""A figure with more in it goes into the page as PNG, so that no page grows beyond a few megabytes."""
_MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page, or why there is none: then `address` is empty."""

    kind: Kind
    address: str = ""
    """A data URI that holds the picture."""
    width_mm: float = 0.0
    height_mm: float = 0.0
    why_not: str = ""


def pictures_of(run: RunFile) -> list[Picture]:
    """Draw all that the run has something for."""
    return [_picture(kind, run) for kind in KINDS]


def _picture(kind: Kind, run: RunFile) -> Picture:
    from matplotlib import rc_context

    # Letters as outlines: the page looks the same where the font of the figures is not installed.
    with house_style(), rc_context({"svg.fonttype": "path"}):
        try:
            figure = draw(kind, run)
        except NothingToDraw as reason:
            return Picture(kind, why_not=str(reason))
        width_mm, height_mm = (25.4 * inches for inches in figure.get_size_inches())
        return Picture(kind, _address(figure), width_mm, height_mm)


def _address(figure: Figure) -> str:
    suffix, content = ".svg", rendered(figure, ".svg")
    if len(content) > MOST_SVG_BYTES:
        suffix, content = ".png", rendered(figure, ".png")
    return f"data:{_MEDIA_TYPES[suffix]};base64,{base64.b64encode(content).decode()}"


def render_page(
    run: RunFile, pictures: Sequence[Picture], sentences: Sequence[Sentence], trouble: str = ""
) -> str:
    """Return the page of an open run file.

    sentences : in order of time; the first says what was wanted, the last what ended the run
    trouble : what ended a run that is not done, and what to do about it; empty where nobody has said so
    """
    numbers = numbers_of(run)
    title = run.text("/entry/title") or run.text("/entry/run_id")
    style = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    links = "".join(f'<a href="#{name}">{heading}</a>' for name, heading in _CONTENTS)
    body = [
        _section("wanted", [_paragraph(sentence.text) for sentence in sentences[:1]], _wanted(run)),
        _section("numbers", [_tiles(run, numbers)], page_tables.all_numbers(run)),
        _section("figures", _figures(pictures)),
        _section("story", [_history(sentences[1:])]),
        _section("source", [_table(page_tables.provenance(run))]),
    ]
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="generator" content="edmctl">',
            f"<title>{escape(title)}, {escape(run.text('/entry/run_id'))}</title>",
            '<link rel="icon" href="data:,">',
            f"<style>\n{style}</style>",
            "</head>",
            "<body>",
            "<header>",
            f"<h1>{escape(title)}</h1>",
            _paragraph(_subtitle(run), "sub"),
            f'<p><span class="status {"done" if _is_done(run) else "other"}">{escape(_status(run))}</span></p>',
            *(
                []
                if _is_done(run)
                else [_paragraph(trouble or (sentences[-1].text if sentences else ""), "trouble")]
            ),
            f"<nav>{links}</nav>",
            "</header>",
            "<main>",
            *body,
            "</main>",
            f"<footer>{_paragraph(f'From {run.path.name} alone. ± is half the 95 % interval.')}</footer>",
            "</body>",
            "</html>",
            "",
        ]
    )


def _is_done(run: RunFile) -> bool:
    return run.text("/entry/status") == "done"


def _status(run: RunFile) -> str:
    simulated = " · simulated" if run.is_simulated else ""
    return f"{run.text('/entry/status') or UNKNOWN}{simulated}"


def _subtitle(run: RunFile) -> str:
    time_s = plain_number((run.summary() or {}).get("time_s"))
    took = f" · {duration(time_s)}" if math.isfinite(time_s) else ""
    return f"{run.text('/entry/run_id')} · {run.text('/entry/start_time')[:16].replace('T', ' ')}{took}"


def _wanted(run: RunFile) -> list[PageTable | str]:
    """What was changed for the run, and every value behind a line to open."""
    parts: list[PageTable | str] = []
    if changed := page_tables.overrides(run):
        parts.append(changed)
    if every := page_tables.profile_values(run):
        parts.append(f"<details><summary>{every.caption}</summary>\n{_table(every)}\n</details>")
    return parts


def _tiles(run: RunFile, numbers: RunNumbers) -> str:
    """The few numbers that matter most."""
    tiles = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(more)}</small></dd></div>"
        for name, value, more in _key_numbers(run, numbers)
    )
    return f'<dl class="tiles">{tiles}</dl>' if tiles else ""


def _key_numbers(run: RunFile, numbers: RunNumbers) -> Iterator[tuple[str, str, str]]:
    sites, totals = numbers.sites, numbers.totals
    estimated = estimated_depth(run)
    if math.isfinite(estimated.depth_um):
        yield (
            "depth so far",
            about(estimated.depth_um, estimated.depth_u95_um),
            "of what was left without a result",
        )
    if not sites:
        return
    target = target_depths_um(run.profile_values())
    several = len(sites) > 1
    of_many = f"mean of {len(sites)} sites" if several else ""
    wanted = f"wanted {target[0]:g} ± {target[1]:g} µm" if target and not several else of_many
    if numbers.depth_name == TIP and not several:
        wanted = f"through the sheet of {sites[0].length_um:g} µm"
    for called, name, of_what in ((numbers.depth_name, "depth", wanted), ("tool wear", "wear", of_many)):
        text = with_u95(numbers.mean(f"{name}_um"), numbers.mean(f"{name}_u95_um"))
        basis = weakest(getattr(site, f"{name}_basis") for site in sites)
        yield called, f"{marked(text, basis)} µm", of_what
    if several:
        depths_um = [site.depth_um for site in sites if math.isfinite(site.depth_um)]
        yield (
            f"{numbers.depth_name}, range",
            f"{decimal(min(depths_um))} to {decimal(max(depths_um))} µm",
            "the least and the greatest",
        )
    yield "machining", duration(numbers.total("machining_time_s")), "with the servo on"
    yield "removal rate", removal_rate(totals.mrr_mm3_min), "volume over machining time"
    per = "the sheet's thickness" if numbers.depth_name == TIP else "depth"
    yield "wear ratio", decimal(totals.wear_ratio_lin, 3), f"wear over {per}"
    yield (
        "arcs",
        percent(totals.ratios.arc, 2),
        f"of {count(totals.pulses, NARROW)} pulses",
    )


def _figures(pictures: Sequence[Picture]) -> list[str]:
    drawn = [picture for picture in pictures if picture.address]
    absent = [picture for picture in pictures if not picture.address]
    parts = (
        ['<div class="figures">', *(_figure(n, p) for n, p in enumerate(drawn, 1)), "</div>"] if drawn else []
    )
    if absent:
        reasons = "".join(
            f"<li>{escape(picture.kind.title)}: {escape(picture.why_not)}</li>" for picture in absent
        )
        parts.append(f'<details class="absent"><summary>Not drawn</summary>\n<ul>{reasons}</ul>\n</details>')
    return parts


def _figure(number: int, picture: Picture) -> str:
    kind = picture.kind
    wide = ' class="wide"' if picture.width_mm > WIDE_MM else ""
    width, height = (round(mm * PX_PER_MM) for mm in (picture.width_mm, picture.height_mm))
    source = ", ".join(f"<code>{path}</code>" for path in kind.datasets)
    return (
        f'<figure id="{kind.name}"{wide}><img src="{picture.address}" width="{width}" height="{height}" '
        f'alt="{escape(kind.sees)}">\n'
        f"<figcaption><b>Fig. {number}: {escape(kind.title)}.</b> {escape(kind.sees)} From {source}.</figcaption>"
        "</figure>"
    )


def _history(sentences: Sequence[Sentence]) -> str:
    rows = [(duration(sentence.time_s), sentence.text) for sentence in sentences]
    return _table(page_tables.PageTable("", ("at", ""), rows, words=True))


def _section(name: str, parts: Sequence[str], tables: Sequence[PageTable | str] = ()) -> str:
    inside = [part for part in parts if part]
    inside += [part if isinstance(part, str) else _table(part) for part in tables]
    return "\n".join([f'<section id="{name}">', f"<h2>{_HEADINGS[name]}</h2>", *inside, "</section>"])


def _table(table: PageTable) -> str:
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    header = ""
    if any(table.header):
        cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
        header = f"<thead><tr>{cells}</tr></thead>"
    rows = "\n".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(
            f'<td data-name="{escape(name)}">{escape(cell)}</td>'
            for name, cell in zip(table.header[1:], row[1:], strict=False)
        )
        + "</tr>"
        for row in table.rows
    )
    kind = "words" if table.words else "numbers"
    note = f'\n<p class="note">{escape(table.note)}</p>' if table.note else ""
    name = escape(table.caption or "table")
    return (
        f'<div class="scroll" tabindex="0" role="group" aria-label="{name}"><table class="{kind}">{caption}{header}'
        f"<tbody>\n{rows}\n</tbody></table></div>{note}"
    )


def _paragraph(text: str, name: str = "") -> str:
    return f'<p class="{name}">{escape(text)}</p>' if name else f"<p>{escape(text)}</p>"
