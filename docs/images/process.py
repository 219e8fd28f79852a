"""Draws the trends of the virtual process: `python docs/images/process.py [--seeds 2]` makes `process.svg`.

Points are whole jobs on the virtual machine, judged by its truth; lines are what forecasts go by, the steady gap.
"""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from benchmarks.process_trends import OFF_US, ON_US, Made, Trials, pulses  # noqa: E402
from edmctl.errors import EdmWarning  # noqa: E402
from edmctl.process.erosion import (  # noqa: E402
    GAP_LAW,
    roughness_ra_um,
    side_gap_um,
)
from edmctl.process.steady_gap import GapRecipe, SteadyGap, steady_gap  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes

PAPER = GapRecipe(ON_US, OFF_US, 40.0, 0.12, 0.8, 270.0)
DEPTH_UM = 40.0
CURRENTS_A = (0.03, 0.06, 0.12, 0.24, 0.5, 1.0)
AT_80_V = ("pulse.open_voltage_v=80", "servo.reference=0.55", "servo.forward_um_s=20", "servo.back_um_s=20")


def mean_of(**changes: float | bool) -> SteadyGap:
    """The gap of the paper's recipe with other values, on average over such a hole."""
    return steady_gap(replace(PAPER, **changes), 0.58 * DEPTH_UM)  # type: ignore[arg-type]


def drawn(
    axes: Axes,
    x: Sequence[float],
    made: Sequence[Made],
    expected: Callable[[float], float],
    of: Callable[[Made], float],
    label: str,
) -> None:
    """Points of the virtual machine, and the line of the forecast in the same colour."""
    (points,) = axes.plot(x, [of(one) for one in made], "o", markersize=4, label=label)
    steps = [x[0] * (x[-1] / x[0]) ** (i / 60) for i in range(61)]
    axes.plot(steps, [expected(one) for one in steps], color=points.get_color(), linewidth=1.0)


def main() -> None:
    """Run the jobs and draw."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    seeds = range(1, parser.parse_args().seeds + 1)
    warnings.simplefilter("ignore", EdmWarning)
    mpl.rcParams.update(
        {"font.size": 8, "svg.hashsalt": "edmctl", "svg.fonttype": "none", "legend.frameon": False}
    )
    figure, grid = plt.subplots(2, 3, figsize=(9.6, 5.6), layout="constrained")
    with ProcessPoolExecutor() as pool:
        trials = Trials(pool, seeds, 0.0)
        reference(grid[0][0], trials)
        on_time(grid[0][1], trials)
        off_time(grid[0][2], trials)
        wear(grid[1][0], trials)
        current(grid[1][1], grid[1][2], trials)
    for axes in grid.flat:
        axes.grid(visible=True, linewidth=0.3)
        axes.set_ylim(bottom=0.0 if axes.get_yscale() == "linear" else None)
        axes.legend(fontsize=7)
    figure.suptitle(
        "Trends of the virtual machine (points, whole jobs) and of forecasts (lines); Cu 270 µm on Cu"
    )
    picture = HERE / "process.svg"
    figure.savefig(picture, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    drawn_text = picture.read_text(encoding="utf-8")
    picture.write_text(re.sub(r"<!DOCTYPE.*?>\n", "", drawn_text, flags=re.DOTALL), encoding="utf-8")


def reference(axes: Axes, trials: Trials) -> None:
    """Removal over the servo's reference, in two flushings."""
    levels = [0.60 + 0.04 * i for i in range(8)]
    for flush_s in (0.5, 2.0):
        made = trials.tried(
            DEPTH_UM, *((f"servo.reference={s}", f"sim.flush_time_s={flush_s}") for s in levels)
        )

        def expected(s: float, flush_s: float = flush_s) -> float:
            return 1e-3 * mean_of(level_s=s, flush_time_s=flush_s).removal_um3_s

        drawn(axes, levels, made, expected, lambda one: 1e-3 * one.mrr_um3_s, f"clearance in {flush_s:g} s")
    axes.set(xlabel="servo reference", ylabel="removal, 10³ µm³/s", title="servo reference")


def on_time(axes: Axes, trials: Trials) -> None:
    """Removal over the on-time."""
    times_us = [12.0, 30.0, 50.0, 75.0, 100.0, 130.0, 180.0, 300.0]
    made = trials.tried(DEPTH_UM, *(pulses(t, t * 7.0 / 3.0) for t in times_us))
    drawn(
        axes,
        times_us,
        made,
        lambda t: 1e-3 * mean_of(on_time_us=t, off_time_us=t * 7.0 / 3.0).removal_um3_s,
        lambda one: 1e-3 * one.mrr_um3_s,
        "duty 0.30",
    )
    axes.set(xlabel="on-time, µs", ylabel="removal, 10³ µm³/s", title="on-time")


def off_time(axes: Axes, trials: Trials) -> None:
    """Removal over the off-time, at three on-times."""
    for on_us in (30.0, 60.0, 130.0):
        times_us = [t for t in (20.0, 30.0, 40.0, 60.0, 85.0, 120.0, 200.0) if on_us / (on_us + t) <= 0.85]
        made = trials.tried(DEPTH_UM, *(pulses(on_us, t) for t in times_us))

        def expected(t: float, on_us: float = on_us) -> float:
            return 1e-3 * mean_of(on_time_us=on_us, off_time_us=t).removal_um3_s

        drawn(axes, times_us, made, expected, lambda one: 1e-3 * one.mrr_um3_s, f"on for {on_us:g} µs")
    axes.set(xlabel="off-time, µs", ylabel="removal, 10³ µm³/s", title="off-time")


def wear(axes: Axes, trials: Trials) -> None:
    """Wear over the on-time, for both polarities."""
    times_us = [30.0, 75.0, 130.0, 180.0, 240.0, 300.0]
    for polarity in ("tool-negative", "tool-positive"):

        def expected(t: float, polarity: str = polarity) -> float:
            return mean_of(
                on_time_us=t, off_time_us=100.0, tool_negative=polarity == "tool-negative"
            ).wear_ratio

        made = trials.tried(
            20.0,
            *(
                (*pulses(t, 100.0), f'pulse.polarity="{polarity}"', f"wear.expected_ratio={expected(t):.3f}")
                for t in times_us
            ),
        )
        drawn(axes, times_us, made, expected, lambda one: one.theta, polarity)
    axes.set(xlabel="on-time, µs", ylabel="wear, volume per volume", title="tool wear, 100 µs off")
    axes.set_yscale("log")


def current(removal: Axes, lengths: Axes, trials: Trials) -> None:
    """Removal, side gap and roughness over the current."""
    made = trials.tried(DEPTH_UM, *((*AT_80_V, f"pulse.current_a={a}") for a in CURRENTS_A))

    def at(current_a: float) -> SteadyGap:
        return mean_of(open_voltage_v=80.0, level_s=0.55, current_a=current_a)

    def side_um(current_a: float) -> float:
        return side_gap_um(GAP_LAW, 80.0, replace(PAPER, current_a=current_a).full_pulse_uj)

    def ra_um(current_a: float) -> float:
        gap = at(current_a)
        return 10.0 * roughness_ra_um(gap.crater_um3, gap.arc_share / gap.spark_share)

    drawn(
        removal,
        CURRENTS_A,
        made,
        lambda a: 1e-3 * at(a).removal_um3_s,
        lambda one: 1e-3 * one.mrr_um3_s,
        "80 V",
    )
    removal.set(xlabel="current, A", ylabel="removal, 10³ µm³/s", title="current")
    drawn(lengths, CURRENTS_A, made, side_um, lambda one: one.side_gap_um, "side gap")
    drawn(lengths, CURRENTS_A, made, ra_um, lambda one: 10.0 * one.ra_um, "10 · Ra")
    lengths.set(xlabel="current, A", ylabel="µm", title="side gap and roughness, 80 V")


if __name__ == "__main__":
    main()
