"""Depth error of each hole at its place on the work, and in the order of machining, with the tool's wear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, is_open, marked, open_marks
from edmctl.report.numbers import numbers_of
from edmctl.report.style import (
    BLACK,
    BLUE,
    DEVIATIONS,
    GREY,
    PAGE_MM,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    new_figure,
)
from edmctl.wording import signed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

_MARKS = {
    Basis.MODEL: marked(" by model", Basis.MODEL),
    Basis.ESTIMATED: marked(" not touched", Basis.ESTIMATED),
}
LABELLED = 36
"""So many holes have room for their numbers."""
MOST_TICKS = 16
"""Of holes below the axis that there is room for."""
LONGEST_LEVEL = 4
"""Letters of a name that are written side by side."""
LEAST_SPAN_UM = 0.5
"""Where no tolerance says how far colours span, they span at least this, or noise would look like a pattern."""


@dataclass(frozen=True, slots=True)
class _Holes:
    """Holes in the order of machining: ndarrays of shape (n,), µm; `tolerance_um` is NaN without a target depth."""

    names: list[str]
    """Short ones: of `hole-1`, `hole-2`, … the numbers."""
    x_um: Array
    y_um: Array
    error_um: Array
    error_u95_um: Array
    wear_um: Array
    wear_u95_um: Array
    tolerance_um: float
    against: str
    """What the error is against, in words."""
    depth_basis: list[str]
    wear_basis: list[str]


def draw(run: RunFile) -> Figure:
    """Draw the holes to scale, coloured by depth minus target; where no depth was wanted, minus their mean."""
    holes = _holes(run)
    figure = new_figure(82.0, PAGE_MM)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.25, 1.0], height_ratios=[1.25, 1.0])
    places = figure.add_subplot(grid[:, 0])
    _draw_map(figure, places, holes)
    errors = figure.add_subplot(grid[0, 1])
    wear = figure.add_subplot(grid[1, 1], sharex=errors)
    _draw_errors(errors, holes)
    _draw_wear(wear, holes)
    letter_panels((places, errors, wear))
    figure.align_ylabels([errors, wear])
    return figure


def _holes(run: RunFile) -> _Holes:
    values = run.profile_values()
    if "path.kind" in values:
        raise NothingToDraw("The run made a channel, no holes: `--kind channel` draws it.")
    sites = [site for site in numbers_of(run).sites if np.isfinite(site.length_um)]
    if not sites:
        raise NothingToDraw("No hole was measured: the run ended before its first measuring stop.")
    sites = [site for site in sites if not site.through]
    if not sites:
        raise NothingToDraw("The holes go through the sheet: there are no depths to compare.")
    if len(sites) == 1:
        raise NothingToDraw("The run made one hole: `--kind steps` and `--kind erosion` draw it.")
    depth_um = np.array([site.depth_um for site in sites])
    target_um = values.get("target.depth_um")
    if isinstance(target_um, int | float):
        wanted_um, against = float(target_um), f"target {target_um:g} µm"
        tolerance_um = float(values.get("target.tolerance_um", np.nan))
    else:
        wanted_um, tolerance_um = float(depth_um.mean()), np.nan
        against = f"mean {wanted_um:.2f} µm"
    return _Holes(
        names=short_names([site.name for site in sites]),
        x_um=np.array([site.x_um for site in sites]),
        y_um=np.array([site.y_um for site in sites]),
        error_um=depth_um - wanted_um,
        error_u95_um=np.nan_to_num([site.depth_u95_um for site in sites]),
        wear_um=np.array([site.wear_um for site in sites]),
        wear_u95_um=np.nan_to_num([site.wear_u95_um for site in sites]),
        tolerance_um=tolerance_um,
        against=against,
        depth_basis=[site.depth_basis or "" for site in sites],
        wear_basis=[site.wear_basis for site in sites],
    )


def short_names(names: Sequence[str]) -> list[str]:
    """Return what tells names apart: their numbers, where they differ in nothing else."""
    parts = [name.rpartition("-") for name in names]
    alike = len({head for head, _, _ in parts}) == 1 and all(number.isdecimal() for _, _, number in parts)
    return [number for _, _, number in parts] if alike else list(names)


def _draw_map(figure: Figure, axes: Axes, holes: _Holes) -> None:
    from matplotlib.colors import Normalize

    least_um = holes.tolerance_um if np.isfinite(holes.tolerance_um) else LEAST_SPAN_UM
    span_um = max(least_um, float(np.abs(holes.error_um).max()))
    pitch_um = _pitch_um(holes.x_um, holes.y_um)
    middle_um = [0.5 * float(v.min() + v.max()) for v in (holes.x_um, holes.y_um)]
    half_um = [0.5 * float(np.ptp(v)) + 0.62 * pitch_um for v in (holes.x_um, holes.y_um)]
    # A row of holes shall not become a strip that nobody can read.
    half_um = [max(half, 0.35 * max(half_um)) for half in half_um]
    axes.set_xlim(middle_um[0] - half_um[0], middle_um[0] + half_um[0])
    axes.set_ylim(middle_um[1] - half_um[1], middle_um[1] + half_um[1])
    axes.set_aspect("equal")
    dots = _discs(axes, holes, 0.42 * pitch_um)
    dots.set(array=holes.error_um, cmap=DEVIATIONS, norm=Normalize(-span_um, span_um))
    if len(holes.x_um) <= LABELLED:
        for number, _ in enumerate(holes.x_um):
            _label(axes, holes, number, span_um, len(holes.x_um))
    axes.locator_params(nbins=6)
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    marks = [text for basis, text in _MARKS.items() if basis in holes.depth_basis]
    axes.set_title("; ".join([*marks, "discs mark places, not sizes"]), loc="right", pad=3.0)
    bar = figure.colorbar(dots, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)))
    bar.set_label(f"depth − {holes.against.partition(' ')[0]} (µm)")
    bar.outline.set_linewidth(0.6)


def _discs(axes: Axes, holes: _Holes, radius_um: float) -> PatchCollection:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    circles = [Circle(place, radius_um) for place in zip(holes.x_um, holes.y_um, strict=True)]
    discs = PatchCollection(circles, edgecolor=BLACK, linewidth=0.5)
    axes.add_collection(discs)
    return discs


def _label(axes: Axes, holes: _Holes, number: int, span_um: float, count: int) -> Text:
    error_um = holes.error_um[number]
    dark = abs(error_um) > 0.6 * span_um
    error = marked(signed(error_um), holes.depth_basis[number])
    return axes.text(
        holes.x_um[number],
        holes.y_um[number],
        f"{holes.names[number]}\n{error}\n± {holes.error_u95_um[number]:.2f}",
        ha="center",
        va="center",
        fontsize=6.0 if count <= 16 else 4.5,
        linespacing=1.15,
        color="white" if dark else BLACK,
    )


def _pitch_um(x_um: Array, y_um: Array) -> float:
    """Distance of the two nearest holes; any length where all are at one place."""
    apart_um = np.hypot(x_um[:, None] - x_um, y_um[:, None] - y_um)
    others = apart_um[apart_um > 1.0]
    return float(others.min()) if len(others) else 100.0


def _draw_errors(axes: Axes, holes: _Holes) -> None:
    if np.isfinite(holes.tolerance_um):
        axes.axhspan(
            -holes.tolerance_um,
            holes.tolerance_um,
            color="#E8F1F7",
            linewidth=0.0,
            label="tolerance",
            zorder=0,
        )
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    _points(axes, holes.error_um, holes.error_u95_um, holes.depth_basis, BLUE, "o")
    axes.set_ylabel(f"depth − {holes.against.partition(' ')[0]} (µm)")
    axes.tick_params(axis="x", labelbottom=False)
    tolerance = f", ± {holes.tolerance_um:g} µm shaded" if np.isfinite(holes.tolerance_um) else ""
    axes.set_title(f"{holes.against}{tolerance}", loc="right", pad=3.0)


def _draw_wear(axes: Axes, holes: _Holes) -> None:
    _points(axes, holes.wear_um, holes.wear_u95_um, holes.wear_basis, VERMILION, "s")
    axes.set_ylabel("tool wear (µm)")
    axes.set_xlabel("hole, in the order of machining; bars: 95 %")
    axes.set_title(open_marks([*holes.depth_basis, *holes.wear_basis]), loc="right", pad=3.0)
    every = -(-len(holes.names) // MOST_TICKS)
    axes.set_xticks(range(1, len(holes.names) + 1, every), holes.names[::every])
    if max(map(len, holes.names)) > LONGEST_LEVEL:
        axes.tick_params(axis="x", labelrotation=90)
    axes.set_xlim(0.4, len(holes.wear_um) + 0.6)


def _points(axes: Axes, values: Array, u95: Array, bases: Sequence[str], colour: str, mark: str) -> None:
    """Draw values with their bars by the numbers of the holes, open where they were not touched with a sensor."""
    size = 3.4 if len(values) <= 30 else 2.2
    number = np.arange(1, len(values) + 1)
    hollow = np.array([is_open(basis) for basis in bases], np.bool_)
    for some, full in ((~hollow, True), (hollow, False)):
        if some.any():
            draw_points(
                axes, number[some], values[some], u95[some], colour, full=full, marker=mark, size=size
            )
