"""Voltage and current of the gap about a fault: the whole record, and the last pulses before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from edmctl.array_types import Array
from edmctl.record.events import RecordedState
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import Columns, Envelope, Floats, envelopes, within
from edmctl.report.style import BLACK, BLUE, VERMILION, NothingToDraw
from edmctl.wording import plain_number

PATH = "/entry/waveforms"
PERIODS_BEFORE, PERIODS_AFTER = 8.0, 2.0
"""Pulses in the detail."""
POINTS = 1500
MS = 1e-3
FAULTED = (RecordedState.FAULT, RecordedState.ESTOP)


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw without waveforms."""
    time_s = run.column(PATH, "time").astype(np.float64)
    if len(time_s) < 2:
        raise NothingToDraw(
            "The run has no waveforms: the controller latched no fault, or keeps no waveforms about one."
        )
    fault_s = _fault_s(run, time_s)
    zero_s = float(time_s[-1]) if fault_s is None else fault_s
    label = "time before the end (ms)" if fault_s is None else "time after the fault (ms)"
    pair = style.Block(label, {"voltage (V)": 0.75, "current (A)": 0.6})
    figure, axes = style.panels(pair, pair)
    frequency_hz = plain_number(run.profile_values().get("pulse.frequency_hz"))
    period_s = 1.0 / frequency_hz if frequency_hz > 0.0 else float(time_s[-1] - time_s[0]) / 40.0
    near_s = (zero_s - PERIODS_BEFORE * period_s, zero_s + PERIODS_AFTER * period_s)
    first, stop = (int(row) for row in np.searchsorted(time_s, near_s))
    for two, part in ((axes[:2], (0, len(time_s))), (axes[2:], (first, stop))):
        _draw_pair(two, envelopes(run, PATH, ["v_gap", "i_gap"], _as_they_are, part, POINTS), zero_s)
        if fault_s is not None:
            _mark_fault(two)
    return figure


def _fault_s(run: RunFile, time_s: Array) -> float | None:
    """Return when the controller latched the fault: the end of its black box, or the first sample in fault.

    None if neither lies within the waveforms.
    """
    candidates_s = run.column("/entry/black_box", "time")[-1:].tolist()
    faulted = np.flatnonzero(within(run.column("/entry/servo", "state"), FAULTED))
    if len(faulted):
        first = int(faulted[0])
        candidates_s += run.column("/entry/servo", "time", first, first + 1).tolist()
    return next((float(at_s) for at_s in candidates_s if time_s[0] <= at_s <= time_s[-1]), None)


def _as_they_are(columns: Columns) -> dict[str, Floats]:
    return {name: columns[name].astype(np.float32, copy=False) for name in ("v_gap", "i_gap")}


def _draw_pair(pair: Sequence[Axes], lines: Mapping[str, Envelope], zero_s: float) -> None:
    for axes, name, colour in zip(pair, ("v_gap", "i_gap"), (BLUE, VERMILION), strict=True):
        line = lines[name]
        style.draw_envelope(axes, line, MS, colour, width=0.6, begin_s=zero_s)
        axes.set_xlim((line.time_s[0] - zero_s) / MS, (line.time_s[-1] - zero_s) / MS)
        axes.margins(y=0.12)
        # The axis ends with a number, so that no plateau is above all of them.
        ticks = MaxNLocator(3, steps=[1, 2, 5, 10], min_n_ticks=3)
        axes.yaxis.set_major_locator(ticks)
        axes.set_ylim(top=float(ticks.tick_values(*axes.get_ylim())[-1]))


def _mark_fault(pair: Sequence[Axes]) -> None:
    for axes in pair:
        axes.axvline(0.0, color=BLACK, linewidth=0.7, linestyle=(0, (3, 1.5)))
    pair[0].annotate(
        "fault", (0.0, 1.0), xycoords=("data", "axes fraction"), xytext=(0.0, 1.5),
        textcoords="offset points", ha="center", va="bottom", fontsize=6.5,
    )  # fmt: skip
