"""The kinds of figures that can be drawn from a run file: their names, and what each shows.

This module loads nothing; that of a figure is loaded when it is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile

REPORT = "report"
"""The kind that is no figure: one page with all of them."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of figure. `sees` is a sentence on what there is to see, `datasets` where in the file it is from."""

    name: str
    title: str
    sees: str
    datasets: tuple[str, ...]


KINDS = (
    Kind(
        "gap",
        "Gap voltage and displacement",
        "Mean gap voltage with the servo reference, and where the tool was, against time; readings are marked.",
        ("/entry/servo", "/entry/slow", "/entry/touches"),
    ),
    Kind(
        "displacement",
        "Estimated and measured displacement",
        "Tool displacement estimated from the actuator voltage alone beside that of the sensor, and the error "
        "of the estimate, which counts while machining.",
        ("/entry/servo", "/entry/results"),
    ),
    Kind(
        "steps",
        "Surface, bottom and surface again",
        "The readings Z1, Z2 and Z3 of each hole, with the depth, the tool wear and the feed that they give.",
        ("/entry/results", "/entry/touches"),
    ),
    Kind(
        "touching",
        "Touches",
        "Actuator voltage and displacement from Z1 to Z3, with the readings, and a zoom on the last set of touches "
        "of the bottom, with its contacts.",
        ("/entry/servo", "/entry/touches", "/entry/events"),
    ),
    Kind(
        "pulses",
        "Pulse classes",
        "Shares of open pulses, normal discharges, arcs and shorts against time, and over the whole run.",
        ("/entry/slow", "/entry/pulses"),
    ),
    Kind(
        "laue",
        "Ignition delay",
        "Distribution of the ignition delays, and their Laue plot: a straight line where ignition is random.",
        ("/entry/pulses/full",),
    ),
    Kind(
        "erosion",
        "Depth, wear and feed",
        "Estimated depth and tool wear with the measured values, and the feed rate, against time.",
        ("/entry/slow", "/entry/touches", "/entry/results"),
    ),
    Kind(
        "jumps",
        "Electrode jumps and arcs",
        "When the electrode jumped, how often, and the shares of arcs and shorts that asked for it.",
        ("/entry/events", "/entry/slow"),
    ),
    Kind(
        "energy",
        "Discharge energy",
        "Energy of normal discharges and arcs, and the removed volume over it. The discharge energy of the results "
        "is somewhat more: it counts shorts too, and all charge at the plateau of a normal discharge.",
        ("/entry/pulses", "/entry/results"),
    ),
    Kind(
        "spectrum",
        "Spectrum of the gap servo",
        "Power spectral density of gap voltage and displacement while machining, without jumps. Rows slower than "
        "1 kHz are single samples: what is faster than half their rate is folded in. A narrow line is something "
        "periodic, for instance a stage that moves in steps along a path (speed over step).",
        ("/entry/servo",),
    ),
    Kind(
        "waveforms",
        "The gap about a fault",
        "Voltage and current of the last pulses before a fault and of the first ones after it.",
        ("/entry/waveforms", "/entry/black_box"),
    ),
    Kind(
        "array",
        "Array of holes",
        "Depth error and tool wear of each hole, at its place on the work.",
        ("/entry/results",),
    ),
    Kind(
        "channel",
        "Channel",
        "The planned path, the depth of the floor along it and, of a simulated run, the true height map.",
        ("/entry/summary", "/entry/touches", "/entry/truth"),
    ),
)

NAMES = (*(kind.name for kind in KINDS), REPORT)


def kind_called(name: str) -> Kind:
    """Return a kind of figure by its name. Raises StopIteration for another name."""
    return next(kind for kind in KINDS if kind.name == name)


def draw(kind: Kind, run: RunFile) -> Figure:
    """Draw the figure, within `house_style()`. Raises NothingToDraw."""
    module = import_module(f"edmctl.report.figures.{kind.name}")
    make = cast("Callable[[RunFile], Figure]", module.draw)
    return make(run)


def kinds_table() -> str:
    """Return one line per kind, for `--help`."""
    lines = [f"  {kind.name:<13} {kind.title}" for kind in KINDS]
    return "\n".join([*lines, f"  {REPORT:<13} One HTML page with all of them and the numbers"])
