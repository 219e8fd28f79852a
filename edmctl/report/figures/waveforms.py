"""Voltage and current of the gap about a fault: all that was kept, and the last pulses before it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.record.events import RecordedState
from edmctl.report.signals import Envelope, envelopes, within
from edmctl.report.style import (
    BLACK,
    BLUE,
    VERMILION,
    NothingToDraw,
    draw_envelope,
    letter_panels,
    new_figure,
)
from edmctl.wording import plain_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile
    from edmctl.report.signals import Columns, Floats

PATH = "/entry/waveforms"
HEIGHT_MM = 112.0
PERIODS_BEFORE, PERIODS_AFTER = 8.0, 2.0
"""Pulses in the detail."""
POINTS = 1500
MS = 1e-3


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw without waveforms."""
    time_s = run.column(PATH, "time").astype(np.float64)
    if len(time_s) < 2:
        raise NothingToDraw(
            "The run has no waveforms: the controller latched no fault, or keeps no waveforms about one."
        )
    fault_s = _fault_s(run, time_s)
    zero_s = float(time_s[-1]) if fault_s is None else fault_s
    figure = new_figure(HEIGHT_MM)
    panels = figure.subplots(4, 1, height_ratios=[1.0, 0.8, 1.0, 0.8])
    near = np.searchsorted(time_s, _detail(run, time_s, zero_s))
    for pair, part in ((panels[:2], (0, len(time_s))), (panels[2:], (int(near[0]), int(near[1])))):
        lines = envelopes(run, PATH, ["v_gap", "i_gap"], _as_they_are, part, POINTS)
        _draw_pair(pair, lines, zero_s, marked=fault_s is not None)
    for axes in panels[::2]:
        axes.sharex(panels[list(panels).index(axes) + 1])
        axes.tick_params(labelbottom=False)
    panels[1].set_xlabel("time after the fault (ms)" if fault_s is not None else "time before the end (ms)")
    panels[3].set_xlabel(panels[1].get_xlabel())
    letter_panels(panels)
    figure.align_ylabels()
    return figure


def _fault_s(run: RunFile, time_s: Array) -> float | None:
    """Return when the controller latched the fault: the end of its black box, or the first sample in fault.

    None where neither lies within the waveforms.
    """
    candidates_s = [run.column("/entry/black_box", "time")[-1:].astype(np.float64)]
    state = run.column("/entry/servo", "state")
    first = int(np.argmax(within(state, (RecordedState.FAULT, RecordedState.ESTOP)))) if len(state) else 0
    if len(state) and state[first] in (RecordedState.FAULT, RecordedState.ESTOP):
        candidates_s.append(run.column("/entry/servo", "time", first, first + 1).astype(np.float64))
    for found_s in np.concatenate(candidates_s):
        if time_s[0] <= found_s <= time_s[-1]:
            return float(found_s)
    return None


def _detail(run: RunFile, time_s: Array, zero_s: float) -> tuple[float, float]:
    frequency_hz = plain_number(run.profile_values().get("pulse.frequency_hz"))
    period_s = 1.0 / frequency_hz if frequency_hz > 0.0 else float(time_s[-1] - time_s[0]) / 40.0
    return zero_s - PERIODS_BEFORE * period_s, zero_s + PERIODS_AFTER * period_s


def _as_they_are(columns: Columns) -> dict[str, Floats]:
    return {name: columns[name].astype(np.float32, copy=False) for name in ("v_gap", "i_gap")}


def _draw_pair(
    panels: NDArray[np.object_], lines: Mapping[str, Envelope], zero_s: float, *, marked: bool
) -> None:
    from matplotlib.ticker import MaxNLocator

    for axes, name, colour, label in (
        (panels[0], "v_gap", BLUE, "voltage (V)"),
        (panels[1], "i_gap", VERMILION, "current (A)"),
    ):
        line = lines[name]
        draw_envelope(axes, line, MS, colour, width=0.6, begin_s=zero_s)
        axes.set_xlim((line.time_s[0] - zero_s) / MS, (line.time_s[-1] - zero_s) / MS)
        axes.margins(y=0.12)
        # The axis ends with a number, so that no plateau is above all of them.
        ticks = MaxNLocator(3, steps=[1, 2, 5, 10], min_n_ticks=3)
        axes.yaxis.set_major_locator(ticks)
        axes.set_ylim(top=float(ticks.tick_values(*axes.get_ylim())[-1]))
        axes.set_ylabel(label)
        if marked:
            axes.axvline(0.0, color=BLACK, linewidth=0.7, linestyle=(0, (3, 1.5)))
    if marked:
        _name_fault(panels[0])


def _name_fault(axes: Axes) -> None:
    axes.annotate(
        "fault", (0.0, 1.0), xycoords=("data", "axes fraction"), xytext=(0.0, 1.5),
        textcoords="offset points", ha="center", va="bottom", fontsize=6.5,
    )  # fmt: skip
