"""The kinds of figures that can be drawn from a run file: their names, what each shows, and the files they fit.

This module loads no matplotlib; the module of a figure is loaded when it is drawn.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import installing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile  # numpy, which `--help` does not load

SUFFIXES = (".png", ".svg", ".pdf")
REPORT = "report"
"""The kind that is no figure: one page with all of them."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of figure, drawn by `draw_NAME` of a module of `figures`: caption, and sources in `/entry`."""

    name: str
    module: str
    title: str
    sees: str
    datasets: tuple[str, ...]


KINDS = (
    Kind(
        "gap", "timelines", "Gap voltage and displacement",
        "(a) Mean gap voltage with the servo reference, and (b) the tool position, against time; grey bands mark "
        "touching. The range is from the lowest to the highest value within a step of the drawing. Z1 is the "
        "surface before, Z2 the bottom, Z3 the surface after, Zr the face at a place not yet machined.",
        ("servo", "slow", "touches"),
    ),
    Kind(
        "displacement", "timelines", "Estimated and measured displacement",
        "(a) Tool displacement estimated from the actuator voltage alone beside that of the sensor, and (b) the "
        "error of the estimate, which counts while machining; rms and max are those of the results. The range is "
        "from the lowest to the highest value within a step of the drawing.",
        ("servo", "results"),
    ),
    Kind(
        "steps", "readings", "Surface, bottom and surface again",
        "The readings Z1 (surface before), Z2 (bottom) and Z3 (surface after) of each measured hole, and the "
        "lengths between them: depth is Z2 − Z3, tool wear Z3 − Z1, feed Z2 − Z1.",
        ("results", "touches"),
    ),
    Kind(
        "section", "holes", "The hole in section",
        "The last holes cut through the middle, with the tool at the bottom and its wear. The legend states "
        "whether a depth was measured by contact or estimated; the band is its 95 % interval. The width is not "
        "measured: walls are drawn from the profile's side gap. For a simulated run the line is the true hole, "
        "with its side gap at the floor, its taper (how much wider the mouth is, on the radius) and the round edge "
        "of its floor; its walls are drawn straight.",
        ("results", "profile/values", "summary"),
    ),
    Kind(
        "touching", "readings", "Touches",
        "To touch, the tool moves towards the work until the contact closes a circuit. Where there are several "
        "readings, actuator voltage and displacement from Z1 (surface before) over Z2 (bottom) to Z3 (surface "
        "after), or with Zr (the face at a place not yet machined). In the panels below, the last set of touches "
        "of the bottom with its contacts, and on the right the last contact in detail: while it is held, the "
        "voltage falls because the actuator creeps, and the sensor stays.",
        ("servo", "touches", "events"),
    ),
    Kind(
        "pulses", "pulses", "Pulse classes",
        "Shares of open pulses, normal discharges, arcs and shorts while cutting: (a) against time, (b) arcs and "
        "shorts again, (c) over all cuts. Pulses are counted by their time; where they were summed up in blocks, "
        "the controller's own count in the results may differ by those of a block.",
        ("slow", "pulses"),
    ),
    Kind(
        "laue", "pulses", "Ignition delay",
        "(a) Distribution of the ignition delays, and (b) their Laue plot, the share of pulses that had not "
        "ignited after a time: a straight line where ignition is random.",
        ("pulses/full",),
    ),
    Kind(
        "erosion", "timelines", "Depth, wear and feed",
        "(a) Estimated depth and tool wear with the measured values, and (b) the feed rate, against time. Hollow "
        "points are not measured by contact: they follow from feed and energy, as later touches correct them.",
        ("slow", "touches", "results"),
    ),
    Kind(
        "jumps", "pulses", "Electrode jumps and arcs",
        "(a) Shares of arcs and shorts, which cause jumps, with a mark for each; (b) the jump period in force, "
        "and the time from each jump to the next of the same cut.",
        ("events", "slow"),
    ),
    Kind(
        "energy", "pulses", "Discharge energy",
        "(a) Energy of normal discharges and arcs, and (b) the removed volume over it, by measured and by "
        "estimated depths. κ, volume over energy, is that of the last touched point of each place; its ± is that "
        "of the depth alone, for the width is the tool's and the side gap's of the profile, whose own κ is "
        "dashed.",
        ("pulses", "results"),
    ),
    Kind(
        "waveforms", "pulses", "The gap about a fault",
        "(a) Voltage and (b) current of the last pulses before a fault and of the first ones after it, and (c), "
        "(d) those about the fault in detail.",
        ("waveforms", "black_box"),
    ),
    Kind(
        "array", "holes", "Array of holes",
        "(a) Depth error of each hole at its place on the work, under the number of its name; (b) the same and "
        "(c) the tool wear, in the order of machining.",
        ("results",),
    ),
    Kind(
        "channel", "channel", "Channel",
        "(a) The planned path and (b) the depth of the floor along it; of a simulated run also the true height "
        "map.",
        ("summary", "touches", "truth"),
    ),
)  # fmt: skip
NAMES = (*(kind.name for kind in KINDS), REPORT)


def kind_called(name: str) -> Kind:
    """Return a kind of figure by its name. Raises StopIteration for another name."""
    return next(kind for kind in KINDS if kind.name == name)


def draw(kind: Kind, run: RunFile) -> Figure:
    """Draw the figure, within `house_style()`, with a mark if the run is simulated. Raises NothingToDraw."""
    from edmctl.report.panels import mark_below

    module = import_module(f"edmctl.report.figures.{kind.module}")
    make: Callable[[RunFile], Figure] = getattr(module, f"draw_{kind.name}")
    figure = make(run)
    if run.is_simulated:
        mark_below(figure, "simulated" if run.seed is None else f"simulated, seed {run.seed}")
    return figure


def kinds_table() -> str:
    """Return one line per kind, for `--help`."""
    lines = [f"  {kind.name:<13} {kind.title}" for kind in KINDS]
    return "\n".join([*lines, f"  {REPORT:<13} One HTML page with all of them and the numbers"])


def suffix_of(name: str) -> str:
    """Return the ending of a file name, in small letters; empty without one."""
    return name[name.rfind(".") :].lower() if "." in name else ""


def check_figure(name: str) -> None:
    """Raise UsageError (E2011) if a figure cannot be of this type, PreconditionError (E8090) without matplotlib."""
    if suffix_of(name) not in SUFFIXES:
        raise failures.figure_suffix_unknown(name=name, suffixes=", ".join(SUFFIXES))
    need_matplotlib()


def need_matplotlib() -> None:
    """Raise PreconditionError (E8090) if matplotlib is not installed."""
    if importlib.util.find_spec("matplotlib") is None:
        raise failures.matplotlib_missing(install=installing("matplotlib"))
