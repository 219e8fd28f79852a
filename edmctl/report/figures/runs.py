"""Several runs in one figure: their depth against the time of machining, and the means of simulated cases."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.labels import is_open, open_marks
from edmctl.record.reader import RunFile, sites_of
from edmctl.report import panels, signals, style
from edmctl.report.removal import target_depths_um
from edmctl.results.job import Case
from edmctl.results.run_file import Sites

PAUSE_S = 1.0
"""Rows further apart than this have something else than machining between them."""
NEW_SITE_UM = 2.0
"""An estimated depth that falls by more than this belongs to another place."""
_COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.PURPLE, style.SKY, style.BLACK)
_DASHES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))
QUANTITIES = {
    "mrr_mm3_min": ("removal rate, 10⁻³ mm³/min", 1e3),
    "wear_ratio_lin": ("wear per depth", 1.0),
    "machining_time_s": ("machining time, s", 1.0),
    "arc_share": ("arcs, %", 100.0),
}
MOST_LABELS = 12


def draw_runs(runs: Sequence[RunFile], names: Sequence[str]) -> Figure:
    """Draw open run files under their names. Raises NothingToDraw."""
    sites = [sites_of(run) for run in runs]
    lines = [_depth_line(run) for run in runs]
    if not any(len(time_s) for time_s, _ in lines) and not any(sites):
        raise style.NothingToDraw("None of the runs has machined anything.")
    per, label = style.time_unit(max((time_s[-1] for time_s, _ in lines if len(time_s)), default=0.0))
    figure, (depth, end_depth, end_wear) = panels.panels(
        panels.Block(label.replace("time", "time machining"), {"estimated depth (µm)": 1.9}, (2.0, 1.0, 1.0)),
        width_mm=style.PAGE_MM,
    )
    for number, (name, (time_s, depth_um)) in enumerate(zip(names, lines, strict=True)):
        colour, dash = _COLOURS[number % len(_COLOURS)], _DASHES[number % len(_DASHES)]
        if len(time_s):
            depth.plot(time_s / per, depth_um, color=colour, linestyle=dash, label=name)
    depth.margins(x=0.02)
    several = ", mean of sites" if any(len(one) > 1 for one in sites) else ""
    _draw_results(end_depth, names, sites, "depth")
    _draw_results(end_wear, names, sites, "wear")
    end_depth.set_ylabel(f"depth{several} (µm)")
    end_wear.set_ylabel(f"tool wear{several} (µm)")
    targets = {target_depths_um(run.profile_values()) for run in runs}
    if len(targets) == 1 and (target := targets.pop()) is not None:
        target_um, tolerance_um = target
        ends_um = (target_um - tolerance_um, target_um + tolerance_um)
        end_depth.axhspan(*ends_um, color=style.LIGHT, label="target", zorder=0)
        end_depth.axhline(target_um, color=style.GREY, linewidth=0.6)
    panels.shared_legend(figure, (depth, end_depth), ncols=8)
    simulated = [name for name, run in zip(names, runs, strict=True) if run.is_simulated]
    if simulated:
        is_all = len(simulated) == len(runs)
        panels.mark_below(figure, "all simulated" if is_all else f"simulated: {', '.join(simulated)}")
    return figure


def _depth_line(run: RunFile) -> tuple[Array, Array]:
    """Return the time with the servo on and the estimated depth, with NaN where the tool went to another place."""
    lines = signals.envelopes(
        run, "/entry/slow", ["est_depth"], lambda rows: {"depth": rows["est_depth"].astype(np.float64)}
    )
    if not lines:
        return np.empty(0), np.empty(0)
    found, depth_um = lines["depth"], lines["depth"].mean
    steps_s = np.diff(found.time_s, prepend=found.time_s[0])
    usual_s = float(np.median(steps_s[1:])) if len(steps_s) > 1 else 0.0
    steps_s[steps_s > max(PAUSE_S, 3.0 * usual_s)] = usual_s
    time_s = np.cumsum(steps_s)
    breaks = np.flatnonzero(np.diff(depth_um) < -NEW_SITE_UM) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(depth_um, breaks, np.nan)


def _draw_results(axes: Axes, names: Sequence[str], sites: Sequence[Sites], quantity: str) -> None:
    """Draw a point for each run with its 95 % interval, open if it was not measured with a sensor."""
    bases = [of_run.basis(quantity) for of_run in sites]
    for number, (of_run, basis) in enumerate(zip(sites, bases, strict=True)):
        value, u95 = of_run.mean(f"{quantity}_um"), of_run.mean(f"{quantity}_u95_um")
        colour = _COLOURS[number % len(_COLOURS)]
        panels.draw_points(axes, number, value, u95, colour, full=not is_open(basis))
    panels.note_above(axes, open_marks(bases))
    axes.set_xlabel("run")
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.margins(y=0.15)
    axes.grid(visible=False, axis="x")


def draw_cases(cases: Sequence[Case]) -> Figure:
    """Draw means over the runs of each case, bars of a standard deviation. Raises NothingToDraw for no cases."""
    if not cases:
        raise style.NothingToDraw("no run is finished")
    places, axis, labels = _places(cases)
    figure = panels.new_figure(95.0, 120.0)
    axes = figure.subplots(2, 2, sharex=True)
    for panel, (name, (title, scale)) in zip(axes.flat, QUANTITIES.items(), strict=True):
        found = [
            (x, scale * s.mean, scale * s.sd if math.isfinite(s.sd) else 0.0)
            for x, case in zip(places, cases, strict=True)
            if (s := case.spreads.get(name))
        ]
        if not found:
            panel.text(0.5, 0.5, "nothing measured", ha="center", color=style.GREY, transform=panel.transAxes)
        at, means, bars = np.array(found).reshape(-1, 3).T
        mark = "o" if labels else "o-"
        panel.errorbar(at, means, yerr=bars, fmt=mark, color=style.BLUE, markersize=3, capsize=2)
        panel.set_ylabel(title)
        if labels:
            panel.set_xticks(places, labels, rotation=90)
        panel.margins(x=0.08)
    for panel in axes[1]:
        panel.set_xlabel(axis)
    counts = sorted({len(case.runs) for case in cases})
    runs = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    title = f"means of {runs} runs a case; bars ± one standard deviation of a run"
    title = "one run a case: no bars" if counts[-1] == 1 else title
    figure.suptitle(title, fontsize="small", color=style.GREY)
    return figure


def _places(cases: Sequence[Case]) -> tuple[list[float], str, list[str]]:
    """Return places on the axis of x: values of the one number that differs, else the order of the cases."""
    settings = [dict(part.partition("=")[::2] for part in case.overrides) for case in cases]
    keys = sorted({key for one in settings for key in one if len({other.get(key) for other in settings}) > 1})
    if len(keys) == 1 and len(cases) > 1:
        try:
            return [float(one[keys[0]]) for one in settings], keys[0], []
        except (KeyError, ValueError):
            pass
    words = [", ".join(one.get(key, "") for key in keys) for one in settings]
    names = [word or case.label for word, case in zip(words, cases, strict=True)]
    shown = names if len(names) <= MOST_LABELS else [""] * len(names)
    return [float(n) for n in range(len(cases))], ", ".join(keys) or "case", shown
