"""Pulses: their classes, ignition delays and energies, electrode jumps, and the gap about a fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.record import layout
from edmctl.record.reader import JUMP_DONE, RecordedState, RunFile, recorded_events
from edmctl.report import panels, signals
from edmctl.report import pulse_statistics as statistics
from edmctl.report.panels import Block, note_above, shared_legend
from edmctl.report.removal import Removal, cumulated, in_this_run, kappa, removal
from edmctl.results.telemetry import PULSE_CLASSES
from edmctl.wording import count, percent, plain_number, plural, to_its_u95

INTERVALS = 160
"""Of time over the whole run; a column of a journal shows no more steps."""
FROM_BELOW = ("normal", "open", "arc", "short")
"""Order of the stack: the frequent classes below, the rare ones on top."""
BARS = 50
LEAST_PULSES = 100
"""Least number of discharges for a distribution."""
LEAST_AT_RISK = 20
"""The survivors are drawn while so many pulses remain."""
UM3_PER_MM3, UJ_PER_J = 1e9, 1e6
RANGE_OF_LOG = 8.0
"""A narrower range of periods is drawn on an even scale from 0, where it has more than one label."""
FEW = 400
"""Up to so many jumps a column of a journal can show each mark."""
PERIODS_BEFORE, PERIODS_AFTER = 8.0, 2.0
"""Pulses in the detail about a fault."""
WAVEFORM_POINTS = 1500
MS = 1e-3
FAULTED = (RecordedState.FAULT, RecordedState.ESTOP)


def draw_pulses(run: RunFile) -> Figure:
    """Draw the share of each class in intervals of time, the rare ones again, and over all; only while cutting."""
    cuts = statistics.cuts_with_pulses(run)
    edges_s = np.linspace(cuts[0, 0], cuts[-1, 1], INTERVALS + 1)
    counts = _while_cutting(run, edges_s, cuts)
    if not counts.sum():
        raise panels.NothingToDraw(
            "No pulses were recorded while cutting: the line lost them all, or the cut was too short."
        )
    total = counts.sum(axis=1)[:, None]
    shares = np.divide(100.0 * counts, total, out=np.full(counts.shape, np.nan), where=total > 0)
    by_class = dict(zip(PULSE_CLASSES, shares.T, strict=True))
    per_s, label = panels.time_unit(float(edges_s[-1]))
    share = "share of\npulses (%)"
    figure, (over_time, rare, over_all) = panels.panels(
        Block(label, {share: 1.2, "arcs and\nshorts (%)": 0.9}), Block("", {share: 0.9})
    )
    below = np.where(np.isnan(by_class["open"]), np.nan, 0.0)
    for name in FROM_BELOW:
        above = below + by_class[name]
        over_time.stairs(
            above, edges_s / per_s, baseline=below, fill=True, facecolor=panels.PULSE_COLOURS[name],
            edgecolor="white", hatch=panels.PULSE_HATCHES[name], linewidth=0.0, label=name,
        )  # fmt: skip
        below = above
    over_time.set_ylim(0.0, 100.0)
    for name, dash in panels.PULSE_DASHES.items():
        steps = rare.stairs(by_class[name], edges_s / per_s, baseline=None, linewidth=1.0, linestyle=dash)
        steps.set_edgecolor(panels.PULSE_COLOURS[name])
    rare.set_ylim(bottom=0.0)
    rare.set_xlim(edges_s[0] / per_s, edges_s[-1] / per_s)
    _draw_totals(over_all, dict(zip(PULSE_CLASSES, counts.sum(axis=0).tolist(), strict=True)))
    whole = int(counts.sum())
    # Blocks of pulses lie partly before or after a cut.
    rounded = f"about {count(round(whole, 3 - len(str(whole))))}"
    about = count(whole) if statistics.has_every_pulse(run) else rounded
    of_run = " of this run" if run.text("/entry/parent_run") else ""
    note_above(over_all, f"{about} pulses while cutting{of_run}")
    shared_legend(figure, [over_time], ncols=4)
    return figure


def _while_cutting(run: RunFile, edges_s: Array, cuts: Array) -> NDArray[np.int64]:
    """Return the pulses of each class in each interval, shape (n, 4), without those between the cuts."""
    every_s = np.unique(np.concatenate([edges_s, cuts.ravel()]))
    all_counts = statistics.pulse_counts(run, every_s)
    middle_s = 0.5 * (every_s[:-1] + every_s[1:])
    cut = np.searchsorted(cuts[:, 0], middle_s, side="right") - 1
    cutting = (cut >= 0) & (middle_s < cuts[np.maximum(cut, 0), 1])
    interval = np.clip(np.searchsorted(edges_s, middle_s, side="right") - 1, 0, len(edges_s) - 2)
    counts = np.zeros((len(edges_s) - 1, 4), np.int64)
    np.add.at(counts, interval[cutting], all_counts[cutting])
    return counts


def _draw_totals(axes: Axes, totals: Mapping[str, int]) -> None:
    shares = [totals[name] / sum(totals.values()) for name in FROM_BELOW]
    heights = [100.0 * share for share in shares]
    bars = axes.bar(
        FROM_BELOW, heights, width=0.62, color=[panels.PULSE_COLOURS[name] for name in FROM_BELOW],
        edgecolor="white", linewidth=0.0, hatch=[panels.PULSE_HATCHES[name] for name in FROM_BELOW],
    )  # fmt: skip
    # Two decimals, so that shares can be compared.
    small = {0.0: "none"} | {share: "< 0.01 %" for share in shares if 0.0 < share < 0.5e-4}
    axes.bar_label(bars, [small.get(share, percent(share, 2)) for share in shares], padding=2.0)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0.0, 1.25 * max(heights))


def draw_laue(run: RunFile) -> Figure:
    """Draw the delays of normal discharges, and their Laue plot; open pulses had not ignited within the on-time."""
    if not statistics.has_every_pulse(run):
        raise panels.NothingToDraw(
            "Single pulses were not recorded: `--set log.pulses=full` keeps the ignition delay of each."
        )
    cuts = signals.cuts_s(run)
    if not len(cuts):
        raise panels.NothingToDraw("The run ended before the first cut, so no pulse had a gap to ignite in.")
    found = statistics.delays(run, cuts)
    fit = statistics.random_ignition(found)
    if fit is None or fit.ignited < LEAST_PULSES:
        raise panels.NothingToDraw(
            f"Fewer than {LEAST_PULSES} normal discharges were recorded: a longer run has more."
        )
    steps = len(found.ignited)
    per_bar = -(-steps // BARS)
    label = f"share of pulses\nper {statistics.STEP_US * per_bar:.3g} µs (%)"
    figure, (histogram, laue) = panels.panels(
        Block("ignition delay (µs)", {label: 1.0, "share not yet ignited": 1.25})
    )
    edges = np.append(np.arange(0, steps, per_bar), steps)
    total = found.ignited.sum() + found.censored.sum()
    # The last bar is narrower; heights are those of whole ones.
    heights = 100.0 / total * np.add.reduceat(found.ignited, edges[:-1]) * per_bar / np.diff(edges)
    edges_us = statistics.STEP_US * edges
    histogram.stairs(heights, edges_us, fill=True, color=panels.NORMAL, label="normal discharges")
    histogram.set_xlim(0.0, edges_us[-1])
    _draw_survivors(laue, found, fit)
    note_above(histogram, f"{100.0 * found.censored.sum() / total:.1f} % open: not ignited")
    shared_legend(figure, (histogram, laue), ncols=1)
    return figure


def _draw_survivors(axes: Axes, found: statistics.Delays, fit: statistics.RandomIgnition) -> None:
    surviving = found.surviving
    shown = (surviving > 0.0) & (found.at_risk >= LEAST_AT_RISK)
    delay_us = statistics.STEP_US * (np.arange(len(surviving)) + 0.5)
    axes.plot(delay_us[shown], surviving[shown], color=panels.BLACK, linewidth=1.2, label="not yet ignited")
    line_us = np.array([fit.lag_us, delay_us[shown][-1]])
    label = f"random ignition: mean {to_its_u95(fit.mean_us, fit.mean_u95_us)} µs after a lag of {fit.lag_us:.1f} µs"
    random = np.exp(-(line_us - fit.lag_us) / fit.mean_us)
    axes.plot(line_us, random, color=panels.VERMILION, linestyle=panels.DASHED, linewidth=1.0, label=label)
    axes.set_yscale("log")
    axes.set_ylim(0.9 * surviving[shown][-1], 1.1)
    panels.plain_log_ticks(axes.yaxis)
    note_above(axes, f"{count(fit.ignited)} ignited, {count(fit.censored)} open")


def draw_energy(run: RunFile) -> Figure:
    """Draw the histogram of energies, and the volume by measured depths over the energy of all discharges so far."""
    cuts = statistics.cuts_with_pulses(run)
    found = removal(run)
    edges_s = np.unique(np.concatenate([cuts[[0, -1], [0, 1]], found.began_s, found.time_s]))
    energies = statistics.spark_energies(run, edges_s)
    if energies is None:
        raise panels.NothingToDraw("There was no discharge while cutting: every pulse was open or short.")
    is_resumed = bool(run.text("/entry/parent_run"))
    if is_resumed:
        found = in_this_run(found, _of_hole_uj(found, edges_s, energies.sums_uj))
    of = "" if energies.is_single else ", mean of a block"
    share = f"share of discharges\nper {energies.edges_uj[1]:.2g} µJ (%)"
    blocks = [Block(f"energy per discharge{of} (µJ)", {share: 1.0})]
    if len(found.time_s):
        volume = "volume removed by\nthis run " if is_resumed else "removed volume\n"
        label = f"{volume}(10$^{{-3}}$ mm³)"
        blocks.append(Block("energy of normal discharges and arcs so far (J)", {label: 1.25}))
    figure, axes = panels.panels(*blocks)
    _draw_energies(axes[0], energies)
    for below in axes[1:]:
        expected = float(run.profile_values()["work.removal_um3_per_uj"])
        _draw_volume(below, found, edges_s, energies.sums_uj, expected)
    shared_legend(figure, axes)
    return figure


def _draw_energies(axes: Axes, found: statistics.SparkEnergies) -> None:
    total = found.normal.sum() + found.arc.sum()
    normal, arc = 100.0 * found.normal / total, 100.0 * found.arc / total
    name = "normal discharges" if found.is_single else "normal discharges and arcs"
    axes.stairs(normal, found.edges_uj, fill=True, color=panels.NORMAL, label=name)
    if found.arc.any():
        axes.stairs(
            normal + arc, found.edges_uj, baseline=normal, fill=True, facecolor=panels.ARC, edgecolor=panels.BLACK,
            linewidth=0.0, hatch=panels.PULSE_HATCHES["arc"], label="arcs",
        )  # fmt: skip
    middle_uj = 0.5 * (found.edges_uj[1:] + found.edges_uj[:-1])
    mean_uj = float(((found.normal + found.arc) * middle_uj).sum() / total)
    axes.axvline(mean_uj, color=panels.BLACK, linestyle=panels.DASHED, label=f"mean {mean_uj:.3g} µJ")
    axes.set_xlim(0.0, found.edges_uj[-1])
    note_above(axes, f"{count(int(total))} discharges")


def _of_hole_uj(found: Removal, edges_s: Array, sums_uj: Array) -> Array:
    """Energy spent on the hole of each row until then, shape (n,)."""
    total_uj = np.concatenate([[0.0], np.cumsum(sums_uj)])
    begun_uj = np.interp(found.began_s, edges_s, total_uj)[found.hole]
    spent_uj: Array = np.maximum(0.0, np.interp(found.time_s, edges_s, total_uj) - begun_uj)
    return spent_uj


def _draw_volume(axes: Axes, found: Removal, edges_s: Array, sums_uj: Array, expected: float) -> None:
    """Draw volume over energy; `expected` is the ratio of both in the profile, µm³/µJ."""
    until_uj = np.interp(found.time_s, edges_s, np.concatenate([[0.0], np.cumsum(sums_uj)]))
    volume_um3, u95_um3 = cumulated(found)
    # µm³/µJ times J is 10⁻³ mm³.
    energy_j = np.array([0.0, 1.04 * until_uj.max() / UJ_PER_J])
    label = f"profile: κ = {expected:.3g}"
    axes.plot(energy_j, expected * energy_j, color=panels.GREY, ls=panels.DASHED, linewidth=1.0, label=label)
    fit = kappa(found, _of_hole_uj(found, edges_s, sums_uj))
    if fit is not None:
        label = f"κ = {to_its_u95(fit.value, fit.u95)} µm³/µJ"
        axes.plot(energy_j, fit.value * energy_j, color=panels.VERMILION, linewidth=1.0, label=label)
        # The width of the hole is the profile's; its share of the uncertainty is unknown.
        points = "the last touched point" if fit.holes == 1 else f"{fit.holes} last touched points"
        note_above(axes, f"κ by {points}, ± of depth alone")
    for touched, name in ((True, "by touched depth"), (False, "by estimated depth")):
        rows = found.touched == touched
        if rows.any():
            volume, u95 = (values[rows] / UM3_PER_MM3 * 1e3 for values in (volume_um3, u95_um3))
            panels.draw_points(
                axes, until_uj[rows] / UJ_PER_J, volume, u95, panels.BLUE, full=touched, label=name
            )
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)


def draw_jumps(run: RunFile) -> Figure:
    """Draw the shares of arcs and shorts with a mark for each electrode jump, and the time from jump to jump."""
    at_s = np.array([event.time_s for event in recorded_events(run, JUMP_DONE)])
    if not len(at_s):
        mode = run.profile_values().get("jump.mode", "")
        why = 'its profile says jump.mode = "off"' if mode == "off" else "it ended before the first was due"
        raise panels.NothingToDraw(f"The tool did not jump in this run: {why}.")
    slow = signals.floats(run, layout.SLOW.path, ("time", "r_arc", "r_short", "jump_period"))
    if not len(slow["time"]):
        raise panels.NothingToDraw("The run has jumps, but no rows of the supervisor beside them.")
    per_s, label = panels.time_unit(float(slow["time"][-1]))
    figure, (shares, periods) = panels.panels(
        Block(label, {f"share of pulses,\nmean of {signals.MEAN_S:g} s (%)": 1.15, "jump period (s)": 1.15})
    )
    for name, dash in panels.PULSE_DASHES.items():
        line = signals.broken(slow["time"], signals.running_mean(slow["time"], 100.0 * slow[f"r_{name}"]))
        colour = panels.PULSE_COLOURS[name]
        shares.plot(line.time_s / per_s, line.mean, color=colour, linewidth=1.0, label=f"{name}s", ls=dash)
    top = max(1.0, 1.25 * shares.get_ylim()[1])
    shares.set_ylim(0.0, top)
    if len(at_s) <= FEW:
        marks = np.full(len(at_s), 0.955 * top)
        shares.plot(at_s / per_s, marks, "|", color=panels.BLACK, ms=5.0, mew=0.5, label="jump")
    _draw_periods(periods, slow, at_s, signals.cuts_s(run), per_s)
    note_above(shares, plural(len(at_s), "jump"))
    shared_legend(figure, (shares, periods))
    return figure


def _draw_periods(axes: Axes, slow: dict[str, Array], at_s: Array, cuts: Array, per_s: float) -> None:
    since_s = since_the_last(at_s, cuts)
    period = signals.broken(slow["time"], slow["jump_period"])
    if not period.is_empty:
        panels.draw_envelope(axes, period, per_s, panels.GREY, "jump period in force", 1.2)
    if np.isfinite(since_s).any():
        axes.plot(
            at_s / per_s, since_s, "o", color=panels.BLUE, markersize=2.6 if len(at_s) <= FEW else 1.2,
            markeredgewidth=0.0, label="time since the jump before",
        )  # fmt: skip
    drawn_s = np.concatenate([since_s, slow["jump_period"]])
    drawn_s = drawn_s[drawn_s > 0.0]
    if len(drawn_s) and drawn_s.max() > RANGE_OF_LOG * drawn_s.min():
        axes.set_yscale("log")
        panels.plain_log_ticks(axes.yaxis)
    else:
        axes.set_ylim(0.0, 1.15 * axes.get_ylim()[1])


def since_the_last(at_s: Array, cuts: Array) -> Array:
    """Time since the jump before in the same cut, shape (n,); NaN for the first of a cut and outside of cuts."""
    cut = np.searchsorted(cuts[:, 0], at_s, side="right") - 1
    since_s: Array = np.diff(at_s, prepend=np.nan)
    since_s[(cut < 0) | (np.diff(cut, prepend=-1) != 0)] = np.nan
    return since_s


def draw_waveforms(run: RunFile) -> Figure:
    """Draw voltage and current about a fault: the whole record, and the last pulses before it."""
    path = layout.WAVEFORMS.path
    time_s = run.column(path, "time").astype(np.float64)
    if len(time_s) < 2:
        raise panels.NothingToDraw(
            "The run has no waveforms: the controller latched no fault, or keeps no waveforms about one."
        )

    def as_recorded(columns: signals.Columns) -> dict[str, signals.Floats]:
        return {name: columns[name].astype(np.float32, copy=False) for name in ("v_gap", "i_gap")}

    fault_s = _fault_s(run, time_s)
    zero_s = float(time_s[-1]) if fault_s is None else fault_s
    label = "time before the end (ms)" if fault_s is None else "time after the fault (ms)"
    pair = Block(label, {"voltage (V)": 0.75, "current (A)": 0.6})
    figure, axes = panels.panels(pair, pair)
    frequency_hz = plain_number(run.profile_values().get("pulse.frequency_hz"))
    period_s = 1.0 / frequency_hz if frequency_hz > 0.0 else float(time_s[-1] - time_s[0]) / 40.0
    near_s = (zero_s - PERIODS_BEFORE * period_s, zero_s + PERIODS_AFTER * period_s)
    first, stop = (int(row) for row in np.searchsorted(time_s, near_s))
    for two, part in ((axes[:2], (0, len(time_s))), (axes[2:], (first, stop))):
        lines = signals.envelopes(run, path, ["v_gap", "i_gap"], as_recorded, part, WAVEFORM_POINTS)
        _draw_waveforms(two, lines, zero_s)
        if fault_s is not None:
            for one in two:
                one.axvline(0.0, color=panels.BLACK, linewidth=0.7, linestyle=(0, (3, 1.5)))
            two[0].annotate(
                "fault", (0.0, 1.0), xycoords=("data", "axes fraction"), xytext=(0.0, 1.5),
                textcoords="offset points", ha="center", va="bottom", fontsize=6.5,
            )  # fmt: skip
    return figure


def _fault_s(run: RunFile, time_s: Array) -> float | None:
    """Return when the fault was latched: the end of the black box, or the first sample in fault; None if neither."""
    candidates_s = run.column("/entry/black_box", "time")[-1:].tolist()
    candidates_s += [signals.time_at(run, int(first)) for first in signals.spans_in(run, FAULTED)[:1, 0]]
    return next((float(at_s) for at_s in candidates_s if time_s[0] <= at_s <= time_s[-1]), None)


def _draw_waveforms(pair: Sequence[Axes], lines: Mapping[str, signals.Envelope], zero_s: float) -> None:
    for axes, line, colour in zip(pair, lines.values(), (panels.BLUE, panels.VERMILION), strict=True):
        panels.draw_envelope(axes, line, MS, colour, width=0.6, begin_s=zero_s)
        axes.set_xlim((line.time_s[0] - zero_s) / MS, (line.time_s[-1] - zero_s) / MS)
        axes.margins(y=0.12)
        # The axis ends with a number, so that no plateau is above all of them.
        ticks = MaxNLocator(3, steps=[1, 2, 5, 10], min_n_ticks=3)
        axes.yaxis.set_major_locator(ticks)
        axes.set_ylim(top=float(ticks.tick_values(*axes.get_ylim())[-1]))
