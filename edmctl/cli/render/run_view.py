"""One run on a page: what was wanted, what became of it, and where it is written."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence

from edmctl.cli.render.layout import USUAL_COLUMNS, labelled, wrapped
from edmctl.cli.render.result_table import render_ratios, render_sites
from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.labels import basis_of, marked, weakest
from edmctl.results.run_file import RunSummary, Sentence
from edmctl.wording import (
    about,
    count,
    duration,
    earlier,
    ended_as,
    facts,
    file_size,
    left_at,
    percent,
    printable,
    removal_rate,
    start_utc,
)

MOST_MOMENTS = 24
"""Lines of the time line; where there are more, those in the middle are left out."""
WIDEST = 100
_LABEL = 14


def render_run(run: RunSummary, style: Style = PLAIN) -> str:
    """Render a run in paragraphs no wider than a terminal and `WIDEST`, but for tables of many sites."""
    columns = min(style.columns or USUAL_COLUMNS, WIDEST)
    parts = [
        style.paint("\n".join(wrapped(printable(run.wanted), columns)), Ink.STRONG),
        "\n".join(_lines(_head(run), columns)),
        *render_sites(
            [(site, site.truth if site.truth.is_known else None) for site in run.sites], style, columns
        ),
        "\n".join(_lines(_numbers(run), columns)),
        _moments("time line", run.moments, style, columns, f"edmctl run explain {run.file}"),
        _moments("faults and warnings", run.warnings, style, columns, ""),
        "" if run.warnings else "No faults, no warnings.",
        "\n".join(_lines(_file(run), columns)),
    ]
    return "\n\n".join(filter(None, parts))


def render_sentences(sentences: Sequence[Sentence], style: Style = PLAIN) -> str:
    """Render a line per sentence, its time first."""
    times = [duration(sentence.time_s) for sentence in sentences]
    width = max((len(time) for time in times), default=0)
    return "\n".join(
        f"{style.paint(f'{time:>{width}}', Ink.FAINT)}  {sentence.text}"
        for time, sentence in zip(times, sentences, strict=True)
    )


def _head(run: RunSummary) -> list[tuple[str, str]]:
    times = ""
    if math.isfinite(run.time_s):
        times = f" after {duration(run.time_s)}"
        if math.isfinite(run.machining_time_s):
            times += f", {duration(run.machining_time_s)} of them machining"
        if run.earlier_time_s:
            times += f", {earlier(run.earlier_time_s, run.pause_s)}"
    code = f" (exit code {run.exit_code})" if run.exit_code else ""
    start = start_utc(run.start_time)
    after = f", going on with {run.parent_run}" if run.parent_run else ""
    machine = run.machine
    words = [
        f"{'virtual machine' if run.simulated else 'machine'} {machine['serial']}".rstrip(),
        f"seed {run.seed}" if run.seed is not None else "",
        f"firmware {machine['firmware']}" if machine["firmware"] else "",
    ]
    return [
        ("run", f"{run.run_id}{after}"),
        ("status", f"{ended_as(run.status, run.error_code)}{code}{times}"),
        ("goes on with", run.way_on),
        ("recovered", run.recovery),
        ("started", f"{start} UTC"),
        ("machine", ", ".join(filter(None, words))),
        ("calibration", machine["calibration"].removeprefix("calibration ")),
        ("command", shlex.join(run.command)),
        ("changed", "; ".join(line for line in run.overrides if line.endswith(", --set)"))),
    ]


def _numbers(run: RunSummary) -> list[tuple[str, str]]:
    totals, jumps = run.totals, run.jumps
    pulses = removed = ""
    if totals.pulses:
        pulses = f"{count(totals.pulses)}: {render_ratios(totals.ratios)}"
        mrr, ratio = (
            weakest(basis_of(name, site.depth_basis, site.wear_basis) for site in run.sites)
            for name in ("mrr", "wear_ratio")
        )
        removed = (
            f"{marked(removal_rate(totals.mrr_mm3_min), mrr)} with {totals.energy_j:.3g} J; wear ratio "
            f"{marked(percent(totals.wear_ratio_lin), ratio)} of the length, "
            f"{marked(percent(totals.wear_ratio_vol), ratio)} of the volume"
        ).replace("nan", "–")
    hopped = ""
    if jumps.count:
        hopped = str(jumps.count)
        if math.isfinite(jumps.median_s):
            low, median, high = (f"{s:.1f}" for s in (jumps.shortest_s, jumps.median_s, jumps.longest_s))
            hopped += (
                f", {low} s apart" if low == high else f", {low} to {high} s apart, in the median {median} s"
            )
    found = "" if run.sites else "; ".join(f"{name} {value}" for name, value in facts(run.summary or {}))
    so_far = about(run.est_depth_um, run.est_depth_u95_um) if math.isfinite(run.est_depth_um) else ""
    reached = (run.summary or {}).get("reached")
    left = left_at(reached) if run.sites and isinstance(reached, Mapping) else ""
    return [
        ("found", found),
        ("left at", left),
        ("depth so far", so_far),
        ("pulses", pulses),
        ("removal", removed),
        ("jumps", hopped),
    ]


def _file(run: RunSummary) -> list[tuple[str, str]]:
    rows = ", ".join(f"{name} {count(number)}" for name, number in run.rows.items() if number)
    versions = ", ".join(f"{name} {version}" for name, version in run.software.items() if version)
    return [
        ("file", f"{run.file}, {file_size(run.size_bytes)}"),
        ("rows", rows or "none"),
        ("written by", versions),
    ]


def _moments(title: str, moments: Sequence[Sentence], style: Style, columns: int, rest: str) -> str:
    if not moments:
        return ""
    shown: list[Sentence | None] = list(moments)
    left_out = len(moments) - MOST_MOMENTS
    if left_out > 0:
        shown[MOST_MOMENTS // 2 : -MOST_MOMENTS // 2] = [None]
    times = [duration(moment.time_s) if moment else "" for moment in shown]
    width = max(map(len, times))
    lines = [style.paint(title, Ink.STRONG)]
    more = f" (`{rest}` has them)" if rest else ""
    for time, moment in zip(times, shown, strict=True):
        text = printable(moment.text) if moment else f"… {left_out} more{more}"
        first, *others = wrapped(f"{time:>{width}}  {text}", columns, " " * (width + 2))
        lines += [style.paint(first[:width], Ink.FAINT) + first[width:], *others]
    return "\n".join(lines)


def _lines(pairs: Sequence[tuple[str, str]], columns: int) -> list[str]:
    return [labelled(label, printable(text), _LABEL, columns) for label, text in pairs if text]
