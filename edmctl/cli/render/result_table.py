"""One job: its closing table, and its run on a page: target, results, times, and where it is written."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from math import isfinite, isnan
from typing import TYPE_CHECKING

from edmctl.cli.render.terminal import (
    PLAIN,
    USUAL_COLUMNS,
    Ink,
    Style,
    labelled,
    narrowed,
    render_columns,
    render_table,
    wrapped,
)
from edmctl.labels import Basis, Seen, basis_of, heading, is_doubtful, marked, meanings, weakest
from edmctl.quantity import half_width
from edmctl.results.job import Belief, ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.telemetry import PulseShares
from edmctl.wording import (
    BEYOND_EXIT,
    UNKNOWN,
    about,
    count,
    decimal,
    duration,
    earlier,
    ended_as,
    facts,
    file_size,
    left_at,
    length,
    percent,
    plural,
    printable,
    removal_rate,
    start_utc,
    with_u95,
)

if TYPE_CHECKING:
    from edmctl.results.run_file import RunSummary, Sentence

_LABEL = 21
FIRST_TO_GO = ("feed µm", "stops", "machining")
"""Columns of a table that is too wide, the dispensable ones first: a feed is depth and wear together."""
MOST_BLOCKS = 2
"""Sites with a block of their own; more make a table."""
_SEE = "see `edmctl measure-drift`"


def render_job(
    job: JobResult,
    truths: Sequence[SiteTruth] = (),
    style: Style = PLAIN,
    channel_truth: ChannelTruth | None = None,
    columns: int | None = None,
) -> str:
    """Render one block per site, one line each where there are many, and a closing line.

    truths : one per site on the simulator, empty on hardware. They stand in a column of their own, beside
        what the touches measured (with the half-width of its 95 % interval) and what the actuator model makes
        of the voltage alone.
    """
    columns = columns or min(style.columns or USUAL_COLUMNS, USUAL_COLUMNS)
    padded = (*truths, *[None] * (len(job.sites) - len(truths)))
    blocks = render_sites(list(zip(job.sites, padded, strict=True)), style, columns)
    if len(job.sites) <= MOST_BLOCKS:
        blocks = [f"{block}\n{_pulses(site, columns)}" for block, site in zip(blocks, job.sites, strict=True)]
    if job.channel is not None:
        blocks.append(_channel_block(job.channel, channel_truth, style, columns))
    worn = "the tool's wear was not measured"
    if not isnan(job.tool_wear_total_um):
        worn = f"the tool is {length(max(0.0, job.tool_wear_total_um))} shorter"
    before = f", {earlier(job.earlier_time_s, job.pause_s)}" if job.earlier_time_s else ""
    total = f"Whole job {duration(job.time_s)}{before}; {worn}."
    closing = [*wrapped(beliefs_in_words(job.beliefs), columns), *wrapped(total, columns)]
    if job.not_begun:
        closing[:0] = wrapped(f"Not begun: {', '.join(map(printable, job.not_begun))}.", columns)
    return "\n\n".join([*blocks, "\n".join(closing)])


def render_sites(
    pairs: Sequence[tuple[SiteResult, SiteTruth | None]], style: Style = PLAIN, columns: int = USUAL_COLUMNS
) -> list[str]:
    """Return a block per site, or one table where there are many; what can be done without goes where it is wide."""
    if len(pairs) > MOST_BLOCKS:
        return [_site_lines(pairs, style, columns)]
    return [_site_block(site, truth, style, columns) for site, truth in pairs]


def _site_lines(pairs: Sequence[tuple[SiteResult, SiteTruth | None]], style: Style, columns: int) -> str:
    sites = [site for site, _ in pairs]
    table = {
        "site": [printable(site.name) for site in sites],
        "depth µm": ["through" if site.through else _measured(site, "depth") for site in sites],
        "tool wear µm": [_measured(site, "wear") for site in sites],
        "feed µm": [_measured(site, "feed") for site in sites],
        "stops": [str(site.measuring_stops) for site in sites],
        "machining": [duration(site.machining_time_s) for site in sites],
    }
    if any(truth for _, truth in pairs):
        table["true µm"] = [decimal(truth.depth_um) if truth else UNKNOWN for _, truth in pairs]
    if any(is_doubtful(site.verdict) for site in sites):
        table["verdict"] = [site.verdict or "" for site in sites]
    bases = {basis for site in sites for basis in (site.depth_basis, site.wear_basis)}
    shown = render_table(narrowed(table, columns, FIRST_TO_GO), style)
    return "\n".join([shown, *meanings(bases), *_drift_of_many(sites, columns)])


def _measured(
    site: SiteResult, key: str, head: str = "result", written: Callable[[float, float], str] = with_u95
) -> str:
    """Return depth, wear or feed with its interval, marked where the column's head does not say how it is known."""
    um = written(getattr(site, f"{key}_um"), getattr(site, f"{key}_u95_um"))
    return marked(um, basis_of(key, site.depth_basis, site.wear_basis), head)


def _site_block(site: SiteResult, truth: SiteTruth | None, style: Style, columns: int) -> str:
    bases = (site.depth_basis, site.wear_basis)
    head = heading(bases)
    header = [printable(site.name), head]
    depth, wear, feed = ([key, _measured(site, key, head, length)] for key in ("depth", "wear", "feed"))
    wear[0] = "tool wear"
    if site.through:
        beyond_um = length(site.beyond_exit_um, site.beyond_exit_u95_um)
        depth = [BEYOND_EXIT, marked(beyond_um, site.depth_basis, head)]
    # Without a sensor all lengths are the model's.
    if Basis.MODEL not in bases and isfinite(site.wear_model_um):
        header.append("from voltage")
        depth.append(length(site.depth_model_um, site.depth_model_u95_um))
        wear.append(length(site.wear_model_um, site.wear_model_u95_um))
        feed.append("")
    if truth:
        header.append("truth")
        for row, true_um in ((depth, truth.depth_um), (wear, truth.wear_um), (feed, truth.feed_um)):
            row.append(length(true_um))
    others = [
        feed,
        ["Z1 surface before", length(site.z1_um)],
        ["Z2 tip at the end" if site.through else "Z2 bottom", length(site.z2_um)],
        ["Z3 surface after", length(site.z3_um)],
    ]
    if isfinite(site.face_um) and length(site.face_um) != length(0.0):
        others.append(["face below the pad", length(site.face_um)])
    # A channel has none of them.
    table = render_columns(header, [depth, wear, *(row for row in others if row[1] != UNKNOWN)], style)
    machining = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    if site.through:
        machining += ", through the sheet"
    if site.estimated_um:
        machining += f"; the last {length(site.estimated_um)} were not touched"
        if length(site.z2_um) != UNKNOWN:
            machining += ", Z2 and Z3 are where contact would be"
    surface = ""
    if truth and isfinite(truth.taper_um):
        surface = (
            f"side gap {length(truth.side_gap_um)}, {length(truth.taper_um)} wider at the mouth, "
            f"corner of {length(truth.corner_um)}, Ra {length(truth.ra_um)}, Rz {length(truth.rz_um)}"
        )
    lines = [
        ("machining", machining),
        ("drift", drift_in_words(site)),
        ("true surface", surface),
        ("verdict", str(site.verdict) if is_doubtful(site.verdict) else ""),
    ]
    return "\n".join([table, *_lines(lines, columns, _LABEL), *meanings(bases, head)])


def drift_in_words(found: SiteResult | ChannelResult) -> str:
    """Return what drift there is in the wear: what was taken off, or which command mends it; empty where little.

    It is told where it is more than half of the interval: of the variance, more than a quarter.
    """
    left_um = half_width(found.drift_left_u_um)
    if not isfinite(left_um):
        return ""
    if not found.drift_by_rests:
        return f"± {length(left_um)} of the wear; {_SEE}" if _costs_much(found) else ""
    if not found.drift_correction_um:
        return f"nothing taken off: touches do not see it; ± {length(left_um)} left"
    return f"{length(found.drift_correction_um, left_um)} by the rests, taken off wear and Z values"


def _costs_much(found: SiteResult | ChannelResult) -> bool:
    """Whether uncorrected drift is most of the interval; without a sensor it cannot be corrected."""
    is_cured = found.drift_by_rests or found.wear_basis is Basis.MODEL
    return not is_cured and half_width(found.drift_left_u_um) >= 0.5 * found.wear_u95_um


def _drift_of_many(sites: Sequence[SiteResult], columns: int) -> list[str]:
    """Return the drift in the wear of many holes, in a sentence."""
    by_rests = [site for site in sites if site.drift_by_rests]
    if by_rests:
        far_um = max((site.drift_correction_um for site in by_rests), key=abs)
        words = f"Wear is corrected by the rests, for a drift of {length(far_um)} at most."
        return wrapped(words if far_um else "Drift: touches do not see it, nothing is taken off.", columns)
    left_um = [half_width(site.drift_left_u_um) for site in sites if _costs_much(site)]
    if not left_um:
        return []
    return wrapped(f"Drift: up to ± {length(max(left_um))} of the wear; {_SEE}.", columns)


def beliefs_in_words(beliefs: Sequence[Belief]) -> str:
    """Return what of the setup is contradicted, and what no run can tell; empty where nothing is contradicted."""
    words = [belief.message for belief in beliefs if belief.seen is Seen.CONTRADICTED]
    if not words:
        return ""
    blind = [belief.name for belief in beliefs if belief.seen is Seen.NEVER]
    return " ".join([*words, f"No run can show whether {', '.join(blind)} is right."])


def _pulses(site: SiteResult, columns: int) -> str:
    return labelled("pulses", f"{count(site.pulses)}: {render_ratios(site.ratios)}", _LABEL, columns)


def _channel_block(channel: ChannelResult, truth: ChannelTruth | None, style: Style, columns: int) -> str:
    header = [channel.name, heading((channel.depth_basis, channel.wear_basis))]
    rows = [
        ["depth, mean", length(channel.depth_um, channel.depth_u95_um)],
        ["floor, rms about its mean", length(channel.floor_sd_um)],
        ["tool wear", length(channel.wear_um, channel.wear_u95_um)],
        ["length", length(channel.length_um)],
    ]
    if truth:
        header.append("truth")
        for row, true_um in zip(rows, (truth.depth_um, truth.floor_sd_um, truth.wear_um), strict=False):
            row.append(length(true_um))
    passes = "1 pass" if channel.passes == 1 else f"{channel.passes} passes"
    made = f"{plural(channel.layers, 'layer')} in {passes}"
    lines = [
        ("machining", f"{duration(channel.machining_time_s)}, {made}"),
        ("pulses", f"{count(channel.pulses)}: {render_ratios(channel.ratios)}"),
        ("drift", drift_in_words(channel)),
        ("verdict", str(channel.verdict) if is_doubtful(channel.verdict) else ""),
    ]
    return "\n".join([render_columns(header, rows, style), *_lines(lines, columns, 27)])


def render_ratios(ratios: PulseShares, decimals: int = 2) -> str:
    """Return the shares of the four pulse classes in words."""
    shares = {name: getattr(ratios, name) for name in ("open", "normal", "arc", "short")}
    return ", ".join(f"{percent(share, decimals)} {name}" for name, share in shares.items())


MOST_MOMENTS = 24
"""Lines of the time line; where there are more, those in the middle are left out."""
WIDEST = 100
_RUN_LABEL = 14


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
        _moments("time line", run.moments, style, columns, f" (`edmctl run explain {run.file}` has them)"),
        _moments("faults and warnings", run.warnings, style, columns, ""),
        "" if run.warnings else "No faults, no warnings.",
        "\n".join(_lines(_file(run), columns)),
    ]
    return "\n\n".join(filter(None, parts))


def render_sentences(
    sentences: Sequence[Sentence], style: Style = PLAIN, columns: int | None = None, more: str = ""
) -> str:
    """Render the sentences, the time of each first; within `columns` those in the middle of many are left out."""
    shown: list[Sentence | None] = list(sentences)
    left_out = len(sentences) - MOST_MOMENTS
    if left_out > 0 and columns:
        shown[MOST_MOMENTS // 2 : -MOST_MOMENTS // 2] = [None]
    times = [duration(one.time_s) if one else "" for one in shown]
    width = max(map(len, times), default=0)
    lines = []
    for time, one in zip(times, shown, strict=True):
        text = printable(one.text) if one else f"… {left_out} more{more}"
        first, *others = wrapped(f"{time:>{width}}  {text}", columns, " " * (width + 2))
        lines += [style.paint(first[:width], Ink.FAINT) + first[width:], *others]
    return "\n".join(lines)


def _head(run: RunSummary) -> list[tuple[str, str]]:
    times = ""
    if isfinite(run.time_s):
        times = f" after {duration(run.time_s)}"
        if isfinite(run.machining_time_s):
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
        if isfinite(jumps.median_s):
            low, median, high = (f"{s:.1f}" for s in (jumps.shortest_s, jumps.median_s, jumps.longest_s))
            hopped += (
                f", {low} s apart" if low == high else f", {low} to {high} s apart, in the median {median} s"
            )
    found = "" if run.sites else "; ".join(f"{name} {value}" for name, value in facts(run.summary or {}))
    so_far = about(run.est_depth_um, run.est_depth_u95_um) if isfinite(run.est_depth_um) else ""
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


def _moments(title: str, moments: Sequence[Sentence], style: Style, columns: int, more: str) -> str:
    if not moments:
        return ""
    return f"{style.paint(title, Ink.STRONG)}\n{render_sentences(moments, style, columns, more)}"


def _lines(pairs: Sequence[tuple[str, str]], columns: int, cells: int = _RUN_LABEL) -> list[str]:
    return [labelled(label, printable(text), cells, columns) for label, text in pairs if text]
