"""Signals against time: gap voltage and displacement, the error of the estimated displacement, depth, wear and feed.

Displacement and error are drawn like Figs 3, 7 and 9(b) of Muralidhara et al. 2009.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.record import layout
from edmctl.record.reader import RecordedState, RunFile, has_sensor
from edmctl.report import panels, signals
from edmctl.report.panels import Block, legend_above, note_above
from edmctl.report.removal import KnownDepth, hole_starts_s, known_depths

PALE = "#BDBDBD"
TOGETHER_S = 2.0
"""Touches with no more time between them are one grey band."""
MIN_RATIO = 0.05
"""Below, a gap voltage over its share is mostly rounding."""
SPARKING = (RecordedState.APPROACH, RecordedState.MACHINING)
"""Elsewhere the generator is off, and the telemetry repeats the last gap voltage."""
SHORTED = 0.05
"""A gap voltage below this share of an open gap's is a short: nothing is machined, and the tool may retract."""
PERCENT_MM = 14.0
"""Room for the second axis of the error."""
USUAL_PERCENT, HEADROOM = 90.0, 1.6
"""The feed is drawn up to HEADROOM times this percentile."""
MANY = 30
"""More measured values get smaller marks."""
FAR = 3.0
"""A target so many times as deep as what was drawn is written, not drawn."""
SERVO = layout.SERVO.path
_TOO_EARLY = "The run ended before the first touch or cut; a run that gets further has these signals."


def draw_gap(run: RunFile) -> Figure:
    """Draw mean gap voltage with the servo's reference, and displacement. Raises NothingToDraw without any work."""
    rows = signals.rows_worked(run)
    if rows[1] - rows[0] < 2:
        raise panels.NothingToDraw(_TOO_EARLY)

    def of_gap(columns: signals.Columns) -> dict[str, signals.Floats]:
        sparking = np.isin(columns["state"], SPARKING)
        ratio = columns["s"].astype(np.float32, copy=False)
        gap_v = np.where(sparking, columns["v_gap_avg"], np.float32(np.nan))
        open_v = np.divide(gap_v, ratio, out=np.full_like(gap_v, np.nan), where=ratio > MIN_RATIO)
        return {"gap": gap_v, "open": open_v, **of_tool(columns, "z_sensor")}

    def of_tool(columns: signals.Columns, name: str) -> dict[str, signals.Floats]:
        all_um = columns[name].astype(np.float32, copy=False)
        return {"tool": signals.without_jumps(all_um, columns["state"]), "all": all_um}

    place = "z_sensor"
    lines = signals.envelopes(run, SERVO, ["v_gap_avg", "s", place, "state"], of_gap, rows)
    if lines["all"].is_empty:
        place = "z_model"
        lines |= signals.envelopes(
            run, SERVO, [place, "state"], lambda columns: of_tool(columns, place), rows
        )
    time_s = lines["gap"].time_s
    unit_s, label = panels.time_unit(float(time_s[-1] - time_s[0]))
    block = Block(label, {"mean gap voltage (V)": 1.0, "tool displacement (µm)": 1.25})
    figure, (upper, lower) = panels.panels(block)
    for axes in (upper, lower):
        for begin_s, end_s in _touching_s(run, rows):
            label = "touching" if axes is upper else "_"
            axes.axvspan(begin_s / unit_s, end_s / unit_s, color=panels.LIGHT, linewidth=0.0, label=label)
    _draw_voltage(upper, lines["gap"], _reference_v(run, lines["open"]), unit_s)
    _draw_tool(lower, lines["tool"], lines["all"], unit_s, "sensor" if place == "z_sensor" else "estimated")
    panels.mark_readings(lower, run.table("/entry/touches"), place, unit_s)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    for axes in (upper, lower):
        legend_above(axes)
    return figure


def _touching_s(run: RunFile, rows: tuple[int, int]) -> list[tuple[float, float]]:
    """Return begin and end of the times of touching; those with up to TOGETHER_S between them are one."""
    spans: list[tuple[float, float]] = []
    for span in signals.spans_in(run, [RecordedState.TOUCH]):
        begin_s, end_s = (signals.time_at(run, int(row)) for row in np.clip(span, rows[0], rows[1] - 1))
        if spans and begin_s - spans[-1][1] <= TOGETHER_S:
            begin_s = spans.pop()[0]
        spans.append((begin_s, end_s))
    return spans


def _draw_voltage(axes: Axes, gap: signals.Envelope, reference_v: Array, unit_s: float) -> None:
    if gap.is_empty:
        axes.text(0.5, 0.5, "no sparks in this run", transform=axes.transAxes, ha="center", color=panels.GREY)
        return
    time = gap.time_s / unit_s
    if not gap.sampled:
        axes.fill_between(time, gap.low, gap.high, color=panels.SKY, alpha=0.55, linewidth=0.0, label="range")
    axes.plot(
        time, gap.mean, color=panels.BLUE, linewidth=0.7, label="mean" if not gap.sampled else "gap voltage"
    )
    if np.isfinite(reference_v).any():
        axes.plot(time, reference_v, color=panels.BLACK, linestyle=(0, (3, 1.5)), label="reference")
    axes.set_ylim(0.0, 1.06 * float(np.nanmax(gap.high)))


def _reference_v(run: RunFile, open_gap: signals.Envelope) -> Array:
    """Return the servo's reference, a share of the voltage of an open gap, at its times; NaN outside of cuts."""
    time_s, reference_v = open_gap.time_s, np.full(len(open_gap.time_s), np.nan)
    slow_s, share = signals.floats(run, layout.SLOW.path, ("time", "s_ref")).values()
    known = np.isfinite(open_gap.mean)
    if len(slow_s) and known.any():
        nearest = np.clip(np.searchsorted(slow_s, time_s), 0, len(slow_s) - 1)
        # Rows come at least twice a second while cutting: a second without one is a pause.
        step_s = float(np.median(np.diff(time_s)))
        cutting = np.abs(slow_s[nearest] - time_s) <= max(1.0, 2.0 * step_s)
        open_v = np.interp(time_s, time_s[known], open_gap.mean[known])
        reference_v[cutting] = (share[nearest] * open_v)[cutting]
    return reference_v


def _draw_tool(
    axes: Axes, tool: signals.Envelope, everything: signals.Envelope, unit_s: float, name: str
) -> None:
    time = tool.time_s / unit_s
    resting_um = np.where(np.isnan(tool.low), np.inf, tool.low)
    jumps = np.isfinite(everything.low) & ~(everything.low >= resting_um - 0.5)
    if jumps.any():
        top_um = np.where(np.isnan(tool.mean), everything.high, tool.mean)[jumps]
        axes.vlines(time[jumps], everything.low[jumps], top_um, color=PALE, linewidth=0.5, label="jump")
    if not tool.sampled:
        axes.fill_between(time, tool.low, tool.high, color=panels.BLUE, linewidth=0.0)
    axes.plot(time, tool.mean, color=panels.BLUE, linewidth=0.9, label=name)


def draw_displacement(run: RunFile) -> Figure:
    """Draw the displacement estimated from the voltage beside that of the sensor, and its error."""
    lines = signals.envelopes(
        run, SERVO, ["z_sensor", "z_model", "s", "state"], _compared, signals.rows_worked(run)
    )
    if not lines:
        raise panels.NothingToDraw(_TOO_EARLY)
    sensor, model = lines["sensor"], lines["model"]
    if lines["error"].is_empty:
        missing = "sensor to compare the estimate with" if sensor.is_empty else "estimated from the voltage"
        hint = "" if sensor.is_empty else "; a conditioned or calibrated actuator has one"
        raise panels.NothingToDraw(f"The run has no displacement {missing}{hint}.")
    unit_s, label = panels.time_unit(float(sensor.time_s[-1] - sensor.time_s[0]))
    results = run.table("/entry/results")
    known = results[np.isfinite(results["err_feed_max"])]
    feed_um = float(known["feed"][0]) if len(known) == 1 else 0.0
    figure, (upper, lower) = panels.panels(
        Block(label, {"displacement (µm)": 1.25, "error (µm)": 1.0}),
        right_mm=PERCENT_MM if feed_um > 0.0 else panels.RIGHT_MM,
    )
    time = sensor.time_s / unit_s
    upper.plot(time, sensor.mean, color=panels.GREY, linewidth=2.2, label="sensor")
    upper.plot(time, model.mean, color=panels.BLUE, linestyle=panels.DASHED, label="estimated from voltage")
    _draw_error(lower, time, lines["error"], lines["steady error"])
    if len(known):
        _write_errors(lower, known)
    if feed_um > 0.0:
        to_percent = (lambda um: um * 100.0 / feed_um, lambda percent: percent * feed_um / 100.0)
        percent = lower.secondary_yaxis("right", functions=to_percent)
        percent.set_ylabel("error (% of feed)")
        percent.yaxis.set_major_locator(MaxNLocator(5))
        percent.spines["right"].set_visible(True)
    lower.set_xlim(time[0], time[-1])
    for axes in (upper, lower):
        legend_above(axes)
    return figure


def _compared(columns: signals.Columns) -> dict[str, signals.Floats]:
    state = columns["state"]
    sensor_um, model_um, ratio = (
        columns[name].astype(np.float32, copy=False) for name in ("z_sensor", "z_model", "s")
    )
    error_um = model_um - sensor_um
    sparking = (state == RecordedState.MACHINING) & (ratio > SHORTED)
    return {
        "sensor": signals.without_jumps(sensor_um, state),
        "model": signals.without_jumps(model_um, state),
        "error": error_um,
        "steady error": np.where(sparking, error_um, np.float32(np.nan)),
    }


def _draw_error(axes: Axes, time: Array, everything: signals.Envelope, steady: signals.Envelope) -> None:
    axes.axhline(0.0, color=panels.BLACK, linewidth=0.5)
    if everything.sampled:
        axes.plot(time, everything.mean, color=panels.SKY, linewidth=0.6, label="all")
    else:
        low_um, high_um = everything.low, everything.high
        axes.fill_between(time, low_um, high_um, color=panels.SKY, alpha=0.7, linewidth=0.0, label="range")
    if not steady.is_empty:
        axes.plot(time, steady.mean, color=panels.VERMILION, label="machining, mean")
    axes.locator_params(axis="y", nbins=6)


def _write_errors(axes: Axes, known: NDArray[np.void]) -> None:
    """Write the errors of the results at the foot of the panel, in room that is made for them."""
    rms_um, rms_pct, max_um, max_pct = (
        float(known[f"err_feed_{name}"].max()) for name in ("rms", "rms_pct", "max", "max_pct")
    )
    several = f"largest of {len(known)} holes: " if len(known) > 1 else ""
    text = f"{several}rms {rms_um:.2f} µm ({rms_pct:.2g} %)\nmax {max_um:.2f} µm ({max_pct:.2g} % of feed)"
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.4 * (high - low), high)
    axes.text(0.02, 0.03, text, transform=axes.transAxes, va="bottom", fontsize=6.0)


def draw_erosion(run: RunFile) -> Figure:
    """Draw the estimates of each hole from 0 on, its measured values at the times of their touches, and the feed."""
    columns = ("time", "est_depth", "est_depth_u95", "est_wear", "est_wear_u95", "feed_um_s")
    rows = signals.floats(run, layout.SLOW.path, columns)
    if not np.isfinite(rows["est_depth"]).any():
        raise panels.NothingToDraw("Nothing was cut: the run ended before its first cut.")
    has_feed = bool(np.isfinite(rows["feed_um_s"]).any())
    per_s, label = panels.time_unit(float(rows["time"][-1]))
    feed = {f"feed rate, mean\nof {signals.MEAN_S:g} s (µm/s)": 0.8} if has_feed else {}
    figure, axes = panels.panels(Block(label, {"depth and wear (µm)": 1.5, **feed}))
    erosion = axes[0]
    _draw_estimate(erosion, rows, "depth", per_s, panels.BLUE, "-")
    _draw_estimate(erosion, rows, "wear", per_s, panels.VERMILION, panels.DASHED)
    _draw_known(erosion, known_depths(run, hole_starts_s(run)), per_s, sensor=has_sensor(run))
    _draw_target(erosion, run)
    erosion.set_ylim(bottom=min(0.0, erosion.get_ylim()[0]))
    if has_feed:
        _draw_feed(axes[1], rows, per_s, label)
    else:
        erosion.set_title("no feed rate: the tool was fed by layers", loc="left", pad=2.0)
    panels.shared_legend(figure, [erosion])
    return figure


def _draw_estimate(
    axes: Axes, rows: dict[str, Array], name: str, per_s: float, colour: str, dash: panels.Dash
) -> None:
    """Draw an estimate with its 95 % interval, if that is known."""
    value_um, u95_um = rows[f"est_{name}"], rows[f"est_{name}_u95"]
    if not np.isfinite(value_um).any():
        return
    line = signals.broken(rows["time"], value_um)
    time = line.time_s / per_s
    axes.plot(time, line.mean, color=colour, linestyle=dash, linewidth=1.0, label=f"estimated {name}")
    if np.isfinite(u95_um).any():
        low, high = (
            signals.broken(rows["time"], value_um - u95_um),
            signals.broken(rows["time"], value_um + u95_um),
        )
        label = f"95 % band of {name}"
        axes.fill_between(time, low.low, high.high, color=colour, alpha=0.25, linewidth=0.0, label=label)


def _draw_known(axes: Axes, known: Sequence[KnownDepth], per_s: float, *, sensor: bool) -> None:
    """Draw depths as discs and wear as squares, full where they were measured by contact."""
    size = 2.4 if len(known) > MANY else 3.6
    last_touch_s = max((depth.time_s for depth in known if depth.touched), default=0.0)
    corrected = any(depth.time_s < last_touch_s for depth in known if not depth.touched)
    labels = {
        True: "measured {}" if sensor else "{} by contact, from voltage",
        False: "{} without a touch" + (", corrected later" if corrected else ""),
    }
    for touched, label in labels.items():
        for name, basis, colour, mark in (
            ("depth", "touched", panels.BLUE, "o"),
            ("wear", "wear_touched", panels.VERMILION, "s"),
        ):
            values = [
                (one.time_s / per_s, getattr(one, f"{name}_um"), getattr(one, f"{name}_u95_um"))
                for one in known
                if getattr(one, basis) is touched and np.isfinite(getattr(one, f"{name}_um"))
            ]
            if values:
                time, value_um, u95_um = np.array(values).T
                panels.draw_points(
                    axes, time, value_um, np.nan_to_num(u95_um), colour, full=touched, marker=mark,
                    size=size, label=label.format(name),
                )  # fmt: skip


def _draw_target(axes: Axes, run: RunFile) -> None:
    """Draw the target depth, or the thickness of a sheet that holes go through, unless far above."""
    values: Mapping[str, object] = run.profile_values()
    through = values.get("target.kind") == "through"
    value_um = run.number("/entry/sample/thickness") if through else values.get("target.depth_um")
    if not isinstance(value_um, int | float) or not np.isfinite(value_um):
        return
    label = f"sheet {value_um:g} µm thick" if through else f"target {value_um:g} µm"
    if value_um > FAR * axes.get_ylim()[1]:
        note_above(axes, f"{label}, far above")
    else:
        axes.axhline(value_um, color=panels.GREY, linestyle=(0, (1, 1.5)), label=label)


def _draw_feed(axes: Axes, rows: dict[str, Array], per_s: float, label: str) -> None:
    """Draw the feed rate; the highest, of a tool closing on its gap, is cut off and written with its time."""
    mean_um_s = signals.running_mean(rows["time"], rows["feed_um_s"])
    panels.draw_envelope(axes, signals.broken(rows["time"], mean_um_s), per_s, panels.BLACK)
    highest, usual = (float(np.nanpercentile(mean_um_s, share)) for share in (100.0, USUAL_PERCENT))
    if highest > HEADROOM * usual > 0.0:
        axes.set_ylim(min(0.0, float(np.nanmin(mean_um_s))), HEADROOM * usual)
        at = float(rows["time"][np.nanargmax(mean_um_s)]) / per_s
        unit = label.partition("(")[2].rstrip(")")
        note_above(axes, f"up to {highest:.2g} µm/s at {at:.3g} {unit}, cut off")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
