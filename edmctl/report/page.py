"""One page with all there is to know of a run: HTML that needs nothing but itself, no script and no network."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from html import escape

from edmctl.labels import marked
from edmctl.record.reader import RunFile
from edmctl.record.run_index import estimated_depth, sites_of
from edmctl.report import html, page_tables
from edmctl.report.html import PageTable, Picture
from edmctl.report.kinds import KINDS, draw
from edmctl.report.removal import target_depths_um
from edmctl.results.run_file import Sentence, Sites
from edmctl.wording import (
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

NARROW = "\u202f"
"""A narrow space that a line does not break."""
_CONTENTS = (
    ("wanted", "Wanted"),
    ("numbers", "Numbers"),
    ("figures", "Figures"),
    ("story", "What happened"),
    ("source", "Machine and versions"),
)


def pictures_of(run: RunFile) -> list[Picture]:
    """Draw all that the run has something for, and say why of the rest."""
    return [
        html.picture_of(kind.name, kind.title, kind.sees, partial(draw, kind, run), kind.datasets)
        for kind in KINDS
    ]


def render_page(
    run: RunFile, pictures: Sequence[Picture], sentences: Sequence[Sentence], trouble: str = ""
) -> str:
    """Return the page of an open run file.

    sentences : in order of time; the first says what was wanted, the last what ended the run
    trouble : what ended a run that is not done, and what to do about it; empty if unknown
    """
    title = run.text("/entry/title") or run.text("/entry/run_id")
    source = page_tables.provenance(run)  # all is read before the first figure is rendered
    sections: list[Sequence[PageTable | str]] = [
        [*(html.paragraph(sentence.text) for sentence in sentences[:1]), *_wanted(run)],
        [html.tiles(_key_numbers(run, sites_of(run))), *page_tables.all_numbers(run)],
        html.figures(pictures),
        [_history(sentences[1:])],
        [source],
    ]
    body = [html.section(*names, parts) for names, parts in zip(_CONTENTS, sections, strict=True)]
    status = "done" if _is_done(run) else "other"
    header = [
        f"<h1>{escape(title)}</h1>",
        html.paragraph(_subtitle(run), "sub"),
        f'<p><span class="status {status}">{escape(_status(run))}</span></p>',
    ]
    if not _is_done(run):
        header.append(html.paragraph(trouble or (sentences[-1].text if sentences else ""), "trouble"))
    footer = f"From {run.path.name} alone. ± is half the 95 % interval."
    return html.document(f"{title}, {run.text('/entry/run_id')}", header, _CONTENTS, body, footer)


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
        parts.append(html.folded(every.caption, html.table(every)))
    return parts


def _key_numbers(run: RunFile, sites: Sites) -> Iterator[tuple[str, str, str]]:
    totals, estimated = sites.totals, estimated_depth(run)
    if math.isfinite(estimated.depth_um):
        depth = about(estimated.depth_um, estimated.depth_u95_um)
        yield "depth so far", depth, "of what was left without a result"
    if not sites:
        return
    target = target_depths_um(run.profile_values())
    several = len(sites) > 1
    of_many = f"mean of {len(sites)} sites" if several else ""
    wanted = f"wanted {target[0]:g} ± {target[1]:g} µm" if target and not several else of_many
    shown = [("depth", "depth", wanted), ("tool wear", "wear", of_many)]
    through = all(site.through for site in sites)
    if through:
        yield "depth", "through", f"the sheet of {sites[0].length_um:g} µm"
        del shown[0]
    for called, name, of_what in shown:
        text = with_u95(sites.mean(f"{name}_um"), sites.mean(f"{name}_u95_um"))
        yield called, f"{marked(text, sites.basis(name))} µm", of_what
    depths_um = [site.depth_um for site in sites if math.isfinite(site.depth_um)]
    if several and depths_um:
        ends = f"{decimal(min(depths_um))} to {decimal(max(depths_um))} µm"
        yield "depth, range", ends, "the least and the greatest"
    yield "machining", duration(sites.total("machining_time_s")), "with the servo on"
    rate = marked(removal_rate(totals.mrr_mm3_min), sites.basis("mrr"))
    yield "removal rate", rate, "volume over machining time"
    per = "the sheet's thickness" if through else "depth"
    ratio = marked(decimal(totals.wear_ratio_lin, 3), sites.basis("wear_ratio"))
    yield "wear ratio", ratio, f"wear over {per}"
    yield "arcs", percent(totals.ratios.arc, 2), f"of {count(totals.pulses, NARROW)} pulses"


def _history(sentences: Sequence[Sentence]) -> PageTable:
    rows = [(duration(sentence.time_s), sentence.text) for sentence in sentences]
    return html.PageTable("", ("at", ""), rows, words=True)
