"""One run on a page: what was wanted, what became of it, and where it is written."""

from __future__ import annotations

import math
import shlex
import textwrap
from typing import TYPE_CHECKING, Protocol

from edmctl.console.runs_table import printable, size, start_utc
from edmctl.console.style import PLAIN, Ink, Style
from edmctl.console.tables import render_columns
from edmctl.console.text import count, decimal, duration, length, percent, plural

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from edmctl.console.story import Sentence

CLASSES = ("open", "normal", "arc", "short")
MOST_BLOCKS = 2
"""Sites that are told at length; more make a table."""
MOST_MOMENTS = 24
"""Lines of the time line; where there are more, those in the middle are left out."""
_LABEL = 14


class SiteNumbersView(Protocol):
    """What is known of one hole or channel."""

    @property
    def name(self) -> str: ...
    @property
    def z1_um(self) -> float: ...
    @property
    def z2_um(self) -> float: ...
    @property
    def z3_um(self) -> float: ...
    @property
    def depth_um(self) -> float: ...
    @property
    def depth_u95_um(self) -> float: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def wear_u95_um(self) -> float: ...
    @property
    def feed_um(self) -> float: ...
    @property
    def depth_model_um(self) -> float: ...
    @property
    def wear_model_um(self) -> float: ...
    @property
    def machining_time_s(self) -> float: ...
    @property
    def cuts(self) -> int: ...
    @property
    def truth_depth_um(self) -> float: ...
    @property
    def truth_wear_um(self) -> float: ...


class JumpsView(Protocol):
    """The jumps of a run and the times between them; unknown values are NaN."""

    @property
    def count(self) -> int: ...
    @property
    def shortest_s(self) -> float: ...
    @property
    def median_s(self) -> float: ...
    @property
    def longest_s(self) -> float: ...


class TotalsView(Protocol):
    """Sums over all sites; unknown values are NaN."""

    @property
    def pulses(self) -> int: ...
    @property
    def ratios(self) -> Mapping[str, float]: ...
    @property
    def energy_j(self) -> float: ...
    @property
    def mrr_mm3_min(self) -> float: ...
    @property
    def wear_ratio_lin(self) -> float: ...
    @property
    def wear_ratio_vol(self) -> float: ...


class RunView(Protocol):
    """Everything that is told of a run."""

    @property
    def file(self) -> str: ...
    @property
    def size_bytes(self) -> int: ...
    @property
    def wanted(self) -> str: ...
    @property
    def run_id(self) -> str: ...
    @property
    def parent_run(self) -> str: ...
    @property
    def command(self) -> Sequence[str]: ...
    @property
    def start_time(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def exit_code(self) -> int | None: ...
    @property
    def recovery(self) -> str: ...
    @property
    def time_s(self) -> float: ...
    @property
    def machining_time_s(self) -> float: ...
    @property
    def machine(self) -> Mapping[str, str]: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def software(self) -> Mapping[str, str]: ...
    @property
    def overrides(self) -> Sequence[str]: ...
    @property
    def sites(self) -> Sequence[SiteNumbersView]: ...
    @property
    def totals(self) -> TotalsView: ...
    @property
    def jumps(self) -> JumpsView: ...
    @property
    def summary(self) -> Mapping[str, object] | None: ...
    @property
    def moments(self) -> Sequence[Sentence]: ...
    @property
    def warnings(self) -> Sequence[Sentence]: ...
    @property
    def rows(self) -> Mapping[str, int]: ...


def render_run(run: RunView, style: Style = PLAIN, columns: int = 80) -> str:
    """Render a run in paragraphs no wider than `columns`, but for tables of many sites."""
    parts = [
        style.paint(_wrapped(printable(run.wanted), columns), Ink.STRONG),
        "\n".join(_lines(_head(run), columns)),
        _sites(run.sites, style),
        "\n".join(_lines(_numbers(run), columns)),
        _moments("time line", run.moments, style, columns, f"edmctl run explain {run.file}"),
        _moments("faults and warnings", run.warnings, style, columns, ""),
        "" if run.warnings else "No faults, no warnings.",
        "\n".join(_lines(_file(run), columns)),
    ]
    return "\n\n".join(filter(None, parts))


def _head(run: RunView) -> list[tuple[str, str]]:
    times = ""
    if math.isfinite(run.time_s):
        times = f" after {duration(run.time_s)}"
        if math.isfinite(run.machining_time_s):
            times += f", {duration(run.machining_time_s)} of them machining"
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
        ("status", f"{run.status}{code}{times}"),
        ("recovered", run.recovery),
        ("started", f"{start} UTC"),
        ("machine", ", ".join(filter(None, words))),
        ("calibration", machine["calibration"]),
        ("command", shlex.join(run.command)),
        ("changed", "; ".join(line for line in run.overrides if line.endswith(", --set)"))),
    ]


def _numbers(run: RunView) -> list[tuple[str, str]]:
    totals, jumps = run.totals, run.jumps
    pulses = removed = ""
    if totals.pulses:
        shares = ", ".join(f"{percent(totals.ratios[name])} {name}" for name in CLASSES)
        pulses = f"{count(totals.pulses)}: {shares}"
        removed = (
            f"{totals.mrr_mm3_min:.2g} mm³/min with {totals.energy_j:.3g} J; wear ratio "
            f"{percent(totals.wear_ratio_lin)} of the length, {percent(totals.wear_ratio_vol)} of the volume"
        ).replace("nan", "–")
    hopped = ""
    if jumps.count:
        hopped = str(jumps.count)
        if math.isfinite(jumps.median_s):
            apart = f"{jumps.shortest_s:.1f} to {jumps.longest_s:.1f} s apart"
            hopped += f", {apart}, in the median {jumps.median_s:.1f} s"
    found = "" if run.sites else ", ".join(_facts(run.summary or {}))
    return [("found", found), ("pulses", pulses), ("removal", removed), ("jumps", hopped)]


def _facts(summary: Mapping[str, object]) -> Iterator[str]:
    """The figures of a result without sites, under the keys that they have in JSON."""
    for key, value in summary.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{key} {value:g}"


def _file(run: RunView) -> list[tuple[str, str]]:
    rows = ", ".join(f"{name} {count(number)}" for name, number in run.rows.items() if number)
    versions = ", ".join(f"{name} {version}" for name, version in run.software.items() if version)
    return [
        ("file", f"{run.file}, {size(run.size_bytes)}"),
        ("rows", rows or "none"),
        ("written by", versions),
    ]


def _sites(sites: Sequence[SiteNumbersView], style: Style) -> str:
    if len(sites) > MOST_BLOCKS:
        return _site_lines(sites, style)
    return "\n\n".join(_site_block(site, style) for site in sites)


def _site_block(site: SiteNumbersView, style: Style) -> str:
    header = [printable(site.name), "measured", "from voltage"]
    depth = ["depth", length(site.depth_um, site.depth_u95_um), length(site.depth_model_um)]
    wear = ["tool wear", length(site.wear_um, site.wear_u95_um), length(site.wear_model_um)]
    if math.isfinite(site.truth_depth_um) or math.isfinite(site.truth_wear_um):
        header.append("truth")
        depth.append(length(site.truth_depth_um))
        wear.append(length(site.truth_wear_um))
    z = f"{decimal(site.z1_um)}, {decimal(site.z2_um)}, {decimal(site.z3_um)} µm"
    rows = [depth, wear, ["feed", length(site.feed_um)], ["Z1, Z2, Z3", z]]
    machining = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    return "\n".join([render_columns(header, rows, style), f"{'machining':{_LABEL}}{machining}"])


def _site_lines(sites: Sequence[SiteNumbersView], style: Style) -> str:
    with_truth = any(math.isfinite(site.truth_depth_um) for site in sites)
    header = ["site", "depth", "tool wear", "machining", *(["true depth"] if with_truth else [])]
    rows = [
        [
            printable(site.name),
            length(site.depth_um, site.depth_u95_um),
            length(site.wear_um, site.wear_u95_um),
            duration(site.machining_time_s),
            *([length(site.truth_depth_um)] if with_truth else []),
        ]
        for site in sites
    ]
    return render_columns(header, rows, style, "<>")


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
    told = f" (`{rest}` tells them)" if rest else ""
    for time, moment in zip(times, shown, strict=True):
        text = printable(moment.text) if moment else f"… {left_out} more{told}"
        wrapped = _wrapped(text, columns - width - 2).splitlines() or [""]
        lines.append(f"{style.paint(f'{time:>{width}}', Ink.FAINT)}  {wrapped[0]}")
        lines += [f"{'':{width}}  {line}" for line in wrapped[1:]]
    return "\n".join(lines)


def _lines(pairs: Sequence[tuple[str, str]], columns: int) -> list[str]:
    lines = []
    for label, text in pairs:
        if text:
            wrapped = _wrapped(printable(text), columns - _LABEL).splitlines()
            labels = [label, *[""] * (len(wrapped) - 1)]
            lines += [f"{name:{_LABEL}}{line}" for name, line in zip(labels, wrapped, strict=True)]
    return lines


def _wrapped(text: str, columns: int) -> str:
    return textwrap.fill(text, max(columns, 20), break_long_words=False, break_on_hyphens=False)
