"""Displacement estimated from the actuator voltage beside that of the sensor, and the error of the estimate.

Like Figs 3, 7 and 9(b) of Muralidhara et al. 2009. The numbers are those of `/entry/results`: the error is averaged
over 0.1 s, and counts while machining.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.envelopes import Envelope, State, envelopes, in_states, rows_worked, sampling_hz
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREY,
    SKY,
    VERMILLION,
    NothingToDraw,
    legend_above,
    letter_panels,
    new_figure,
    time_unit,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

HEIGHT_MM = 84.0
SMOOTHED_S = 0.1


class MachiningError:
    """Sums of the error while machining, of samples averaged over SMOOTHED_S."""

    def __init__(self, rate_hz: float) -> None:
        self._size = max(1, round(SMOOTHED_S * rate_hz))
        self._rest: NDArray[np.floating] = np.empty(0, np.float32)
        self._squares = 0.0
        self._count = 0
        self.max_um = math.nan

    @property
    def rms_um(self) -> float:
        """Root mean square, µm; NaN before any."""
        return math.sqrt(self._squares / self._count) if self._count else math.nan

    def take(self, error_um: NDArray[np.floating]) -> None:
        """Take consecutive samples, NaN where the machine was not machining, shape (n,)."""
        samples = np.concatenate([self._rest, error_um])
        rows = len(samples) // self._size
        whole = samples[: rows * self._size].reshape(rows, self._size).astype(np.float64)
        self._rest = samples[rows * self._size :]
        means_um = whole.mean(axis=1)
        means_um = means_um[np.isfinite(means_um)]
        if len(means_um):
            self.max_um = float(np.fmax(self.max_um, np.abs(means_um).max()))
            self._squares += float(means_um @ means_um)
            self._count += len(means_um)


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw without a sensor or an estimate to compare."""
    rows = rows_worked(run)
    machining = MachiningError(sampling_hz(run))

    def derive(columns: Mapping[str, NDArray[np.generic]]) -> dict[str, NDArray[np.floating]]:
        state = columns["state"]
        sensor_um = columns["z_sensor"].astype(np.float32, copy=False)
        model_um = columns["z_model"].astype(np.float32, copy=False)
        error_um = model_um - sensor_um
        machining.take(in_states(error_um, state, [State.MACHINING]))
        resting = state != State.JUMP
        nan = np.float32(np.nan)
        return {
            "sensor": np.where(resting, sensor_um, nan),
            "model": np.where(resting, model_um, nan),
            "error": error_um,
            "steady error": in_states(error_um, state, [State.MACHINING]),
        }

    lines = envelopes(run, "/entry/servo", ["z_sensor", "z_model", "state"], derive, rows)
    if not lines or lines["error"].is_empty:
        raise NothingToDraw(_why_not(lines))
    figure = new_figure(HEIGHT_MM)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.35, 1.0])
    time_s = lines["sensor"].time_s
    unit_s, label = time_unit(float(time_s[-1] - time_s[0]))
    _line(upper, lines["sensor"], unit_s, GREY, 2.2, "-", "sensor")
    _line(upper, lines["model"], unit_s, BLUE, 0.8, (0, (4, 1.5)), "estimated from voltage")
    upper.set_ylabel("displacement (µm)")
    letter_panels((upper, lower))
    _draw_error(lower, lines, unit_s, _whole_um(run, lines), machining)
    lower.set_xlabel(label)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    legend_above(upper)
    legend_above(lower)
    figure.align_ylabels()
    return figure


def _why_not(lines: Mapping[str, Envelope]) -> str:
    if not lines:
        return (
            "The run ended before the first touch or cut, so there is nothing to compare; a run that gets "
            "further has it."
        )
    if lines["sensor"].is_empty:
        return "The run has no displacement sensor to compare the estimate with; on a machine with one it is drawn."
    return "The run has no displacement estimated from the voltage; a conditioned or calibrated actuator has one."


def _line(
    axes: Axes, line: Envelope, unit_s: float, colour: str, width: float, dash: object, label: str
) -> None:
    axes.plot(line.time_s / unit_s, line.mean, color=colour, linewidth=width, linestyle=dash, label=label)


def _whole_um(run: RunFile, lines: Mapping[str, Envelope]) -> tuple[float, str]:
    """Return what an error is given in percent of: the largest feed of the results, else the stroke in use."""
    feeds_um = run.table("/entry/results")["feed"]
    feeds_um = feeds_um[np.isfinite(feeds_um)]
    if len(feeds_um) and feeds_um.max() > 0.0:
        return float(feeds_um.max()), "feed"
    sensor = lines["sensor"]
    return float(np.nanmax(sensor.high) - np.nanmin(sensor.low)), "stroke"


def _draw_error(
    axes: Axes,
    lines: Mapping[str, Envelope],
    unit_s: float,
    whole: tuple[float, str],
    machining: MachiningError,
) -> None:
    everything, steady = lines["error"], lines["steady error"]
    whole_um, of_what = whole
    time = everything.time_s / unit_s
    from matplotlib.ticker import MaxNLocator

    axes.axhline(0.0, color=BLACK, linewidth=0.5)
    if everything.sampled:
        axes.plot(time, everything.mean, color=SKY, linewidth=0.6, label="all")
    else:
        axes.fill_between(
            time, everything.low, everything.high, color=SKY, alpha=0.7, linewidth=0.0,
            label="range",
        )  # fmt: skip
    axes.plot(time, steady.mean, color=VERMILLION, linewidth=0.8, label="machining, mean")
    axes.set_ylabel("error (µm)")
    axes.locator_params(axis="y", nbins=6)
    if whole_um > 0.0:
        percent = axes.secondary_yaxis(
            "right", functions=(_times(100.0 / whole_um), _times(whole_um / 100.0))
        )
        percent.set_ylabel(f"error (% of {of_what})")
        percent.yaxis.set_major_locator(MaxNLocator(5))
        percent.spines["right"].set_visible(True)
    if math.isfinite(machining.max_um):
        rms_um, max_um = machining.rms_um, machining.max_um
        _note(axes, f"cuts: rms {_both(rms_um, whole_um)}, max {_both(max_um, whole_um)}")


def _both(error_um: float, whole_um: float) -> str:
    share = f" ({100.0 * error_um / whole_um:.2g} %)" if whole_um > 0.0 else ""
    return f"{error_um:.2f} µm{share}"


def _note(axes: Axes, text: str) -> None:
    """Write a line at the foot of a panel, in room that is made for it."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.22 * (high - low), high)
    axes.text(0.02, 0.03, text, transform=axes.transAxes, va="bottom", fontsize=6.0)


def _times(factor: float) -> Callable[[ArrayLike], ArrayLike]:
    def scaled(values: ArrayLike) -> ArrayLike:
        return factor * np.asarray(values)

    return scaled
