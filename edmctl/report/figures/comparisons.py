"""Curves side by side: runs by their depth, means of simulated cases, and the actuator beside its models.

Models are drawn like Figs 3–5 of Muralidhara et al. 2009, one column of panels for each waveform.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.labels import is_open, open_marks
from edmctl.record.reader import RunFile, sites_of
from edmctl.report import panels, signals
from edmctl.report.kinds import suffix_of
from edmctl.report.panels import BLACK, BLUE, DASHED, GREY, VERMILION, Block, draw_envelope
from edmctl.report.removal import target_depths_um
from edmctl.report.signals import broken
from edmctl.results.job import Case
from edmctl.results.run_file import Sites

PAUSE_S = 1.0
"""Rows further apart than this have something else than machining between them."""
NEW_SITE_UM = 2.0
"""An estimated depth that falls by more than this belongs to another place."""
_COLOURS = (BLUE, VERMILION, panels.GREEN, panels.ORANGE, panels.PURPLE, panels.SKY, BLACK)
_DASHES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))
QUANTITIES = {
    "mrr_mm3_min": ("removal rate, 10⁻³ mm³/min", 1e3),
    "wear_ratio_lin": ("wear per depth", 1.0),
    "machining_time_s": ("machining time, s", 1.0),
    "arc_share": ("arcs, %", 100.0),
}
MOST_LABELS = 12
STEP_V = 0.5
"""From one sample to the next; a larger change is a step."""
GAP_MM = 4.0
OWN = "edmctl"


def draw_runs(runs: Sequence[RunFile], names: Sequence[str]) -> Figure:
    """Draw open run files under their names. Raises NothingToDraw."""
    sites = [sites_of(run) for run in runs]
    lines = [_depth_line(run) for run in runs]
    if not any(len(time_s) for time_s, _ in lines) and not any(sites):
        raise panels.NothingToDraw("None of the runs has machined anything.")
    per, label = panels.time_unit(max((time_s[-1] for time_s, _ in lines if len(time_s)), default=0.0))
    figure, (depth, end_depth, end_wear) = panels.panels(
        panels.Block(label.replace("time", "time machining"), {"estimated depth (µm)": 1.9}, (2.0, 1.0, 1.0)),
        width_mm=panels.PAGE_MM,
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
        end_depth.axhspan(*ends_um, color=panels.LIGHT, label="target", zorder=0)
        end_depth.axhline(target_um, color=GREY, linewidth=0.6)
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
        raise panels.NothingToDraw("no run is finished")
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
            panel.text(0.5, 0.5, "nothing measured", ha="center", color=GREY, transform=panel.transAxes)
        at, means, bars = np.array(found).reshape(-1, 3).T
        mark = "o" if labels else "o-"
        panel.errorbar(at, means, yerr=bars, fmt=mark, color=BLUE, markersize=3, capsize=2)
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
    figure.suptitle(title, fontsize="small", color=GREY)
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


@dataclass(frozen=True, slots=True)
class Mark:
    """A reading: when, ours, and the paper's range (NaN if it gives none), µm, with their signs."""

    at_s: float
    ours_um: float
    paper_um: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform: ndarrays of shape (n,), displacements of the actuator and of models by their names; readings."""

    title: str
    t_s: Array
    applied_v: Array
    actuator_um: Array
    models_um: Mapping[str, Array]
    marks: Sequence[Mark] = ()

    @property
    def is_smooth(self) -> bool:
        return bool(np.abs(np.diff(self.applied_v)).max() < STEP_V)


def draw_models(trials: Sequence[Trial], name: str, note: str = "") -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm), with a note below it, as file `name`."""
    y = {"voltage (V)": 0.65, "displacement (µm)": 1.4, "error (µm)": 1.0, "edmctl error (µm)": 0.9}
    with panels.house_style():
        figure, columns = _columns_of_models([trial.title for trial in trials], y)
        for trial, axes in zip(trials, columns, strict=True):
            _draw_models(trial, axes, "truth")
            own_error_um = trial.models_um[OWN] - trial.actuator_um
            draw_envelope(axes[3], broken(trial.t_s, own_error_um), 1.0, BLUE)
            _about_zero(axes[3])
            axes[3].locator_params(axis="y", nbins=5)
        panels.shared_legend(figure, [columns[0][1]], ncols=3)
        return _file(figure, name, note)


def draw_paper(trials: Sequence[Trial], name: str, note: str = "") -> bytes:
    """Return the figure of the paper's model beside the sensor, as `draw_models` does.

    Bars in the error show the readings of the paper, dots those of the model. Displacement over voltage is drawn
    where no step crosses it.
    """
    y = {"voltage (V)": 0.7, "displacement (µm)": 1.4, "model − sensor (µm)": 1.25}
    loop = {"displacement (µm)": 1.6} if any(trial.is_smooth for trial in trials) else {}
    titles = [trial.title if len(trials) == 1 else trial.title.replace(", ", "\n") for trial in trials]
    with panels.house_style():
        figure, columns = _columns_of_models(titles, y, loop)
        for trial, axes in zip(trials, columns, strict=True):
            _draw_models(trial, axes, "sensor")
            for mark in trial.marks:
                _draw_mark(axes[2], mark)
            if loop and trial.is_smooth:
                _draw_loop(axes[3], trial)
            elif loop:
                axes[3].set_axis_off()
        panels.shared_legend(figure, [columns[0][1], *(column[2] for column in columns)], ncols=4)
        return _file(figure, name, note)


def _file(figure: Figure, name: str, note: str) -> bytes:
    if note:
        panels.mark_below(figure, note)
    return panels.rendered(figure, suffix_of(name))


def _columns_of_models(
    titles: Sequence[str], y: Mapping[str, float], loop: Mapping[str, float] | None = None
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with a column for each title, and its panels column by column, with titles above."""
    count = len(titles)
    widths = (1.0,) * count
    more_mm = 3.0 * max(title.count("\n") for title in titles)
    blocks = [Block("time (s)", y, widths, share_y=True, above_mm=more_mm)]
    if loop:
        blocks.append(Block("voltage (V)", loop, widths, share_y=True))
    width_mm = panels.COLUMN_MM if count == 1 else panels.PAGE_MM
    figure, axes = panels.panels(*blocks, width_mm=width_mm, gap_mm=GAP_MM)
    for one, title in zip(axes, titles, strict=False):
        one.set_title(title, pad=2.0)
    return figure, [axes[column::count] for column in range(count)]


def _draw_models(trial: Trial, axes: Sequence[Axes], name: str) -> None:
    """Draw voltage, displacements and errors; `name` is that of the actuator's displacement."""
    (voltage, displacement, error), t_s = axes[:3], trial.t_s
    draw_envelope(voltage, broken(t_s, trial.applied_v), 1.0, BLACK, width=0.7)
    draw_envelope(displacement, broken(t_s, trial.actuator_um), 1.0, GREY, name, 2.4)
    for model, values_um in trial.models_um.items():
        colour, dash = (BLUE, "-") if model == OWN else (VERMILION, DASHED)
        draw_envelope(displacement, broken(t_s, values_um), 1.0, colour, model, dash=dash)
        draw_envelope(error, broken(t_s, values_um - trial.actuator_um), 1.0, colour, dash=dash)
    _about_zero(error)
    # Room at both ends, so that what begins at once is not hidden by the axis.
    error.set_xlim(-0.02 * t_s[-1], 1.02 * t_s[-1])
    error.locator_params(axis="x", nbins=4)


def _about_zero(axes: Axes) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.4)
    axes.margins(y=0.12)


def _draw_mark(axes: Axes, mark: Mark) -> None:
    low_um, high_um = mark.paper_um
    if math.isfinite(low_um):
        axes.errorbar(
            [mark.at_s], [0.5 * (low_um + high_um)], yerr=[0.5 * abs(high_um - low_um)], fmt="_", color=BLUE,
            markersize=6.0, elinewidth=1.6, capsize=2.5, label="paper", zorder=4.0,
        )  # fmt: skip
    axes.plot([mark.at_s], [mark.ours_um], "o", color=BLACK, markersize=2.6, label="ours", zorder=5.0)


def _draw_loop(axes: Axes, trial: Trial) -> None:
    part = slice(None, None, max(1, len(trial.t_s) // (4 * signals.POINTS)))
    axes.plot(trial.applied_v[part], trial.actuator_um[part], color=GREY, linewidth=1.6)
    for values_um in trial.models_um.values():
        axes.plot(trial.applied_v[part], values_um[part], color=VERMILION, linestyle=DASHED)
    axes.locator_params(axis="x", nbins=4)
