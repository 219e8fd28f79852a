"""One run on a page: what was wanted, what became of it, and where it is written."""

from __future__ import annotations

import math
import shlex
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from edmctl.console.result_table import render_sites
from edmctl.console.runs_table import size, start_utc
from edmctl.console.style import PLAIN, Ink, Style
from edmctl.console.views import MeasuredView
from edmctl.labels import marked, weakest
from edmctl.wording import (
    about,
    count,
    duration,
    earlier,
    ended_as,
    facts,
    left_at,
    percent,
    printable,
    removal_rate,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.console.story import Sentence
    from edmctl.console.views import TruthView

CLASSES = ("open", "normal", "arc", "short")
MOST_MOMENTS = 24
"""Lines of the time line; where there are more, those in the middle are left out."""
_LABEL = 14


class SiteNumbersView(MeasuredView, Protocol):
    """What is known of one hole or channel; `truth` is None on a real machine."""

    @property
    def truth(self) -> TruthView | None: ...


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
    def error_code(self) -> str: ...
    @property
    def recovery(self) -> str: ...
    @property
    def way_on(self) -> str: ...
    @property
    def time_s(self) -> float: ...
    @property
    def machining_time_s(self) -> float: ...
    @property
    def earlier_time_s(self) -> float: ...
    @property
    def pause_s(self) -> float: ...
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
    def est_depth_um(self) -> float: ...
    @property
    def est_depth_u95_um(self) -> float: ...
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
        *render_sites([(site, site.truth) for site in run.sites], style, columns),
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


def _numbers(run: RunView) -> list[tuple[str, str]]:
    totals, jumps = run.totals, run.jumps
    pulses = removed = ""
    if totals.pulses:
        shares = ", ".join(f"{percent(totals.ratios[name], 2)} {name}" for name in CLASSES)
        pulses = f"{count(totals.pulses)}: {shares}"
        depth = weakest(site.depth_basis for site in run.sites)
        both = weakest([depth, *(site.wear_basis for site in run.sites)])
        removed = (
            f"{marked(removal_rate(totals.mrr_mm3_min), depth)} with {totals.energy_j:.3g} J; wear ratio "
            f"{marked(percent(totals.wear_ratio_lin), both)} of the length, "
            f"{marked(percent(totals.wear_ratio_vol), both)} of the volume"
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


def _file(run: RunView) -> list[tuple[str, str]]:
    rows = ", ".join(f"{name} {count(number)}" for name, number in run.rows.items() if number)
    versions = ", ".join(f"{name} {version}" for name, version in run.software.items() if version)
    return [
        ("file", f"{run.file}, {size(run.size_bytes)}"),
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
