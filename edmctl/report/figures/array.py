"""Depth error of each hole at its place on the workpiece, and in the order of machining, with the tool wear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from edmctl.array_types import Array
from edmctl.labels import Basis, is_open, marked, open_marks
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.numbers import numbers_of
from edmctl.report.style import BLACK, BLUE, GREY, LEFT_MM, PAGE_MM, VERMILION, NothingToDraw
from edmctl.results.run_file import RecordedSite
from edmctl.wording import plain_number, signed

_MARKS = {
    Basis.MODEL: marked(" by model", Basis.MODEL),
    Basis.ESTIMATED: marked(" not touched", Basis.ESTIMATED),
}
MAP_MM, BAR_MM = 74.0, 14.0
"""Width of the map, and of its scale of colours."""
LABELLED = 36
"""Up to so many holes there is room for their numbers."""
MOST_TICKS = 16
"""Of holes below the axis that there is room for."""
LONGEST_LEVEL = 4
"""Letters of a name that are written side by side."""
LEAST_SPAN_UM = 0.5
"""Least span of the colours without a tolerance, or noise would look like a pattern."""


def draw(run: RunFile) -> Figure:
    """Draw the holes to scale, coloured by depth minus target; without a target depth, minus their mean."""
    sites = _holes(run)
    values = run.profile_values()
    target_um, tolerance_um = plain_number(values.get("target.depth_um")), np.nan
    depth_um = np.array([site.depth_um for site in sites])
    against = f"target {target_um:g} µm"
    if np.isfinite(target_um):
        tolerance_um = plain_number(values.get("target.tolerance_um"))
    else:
        target_um = float(depth_um.mean())
        against = f"mean {target_um:.2f} µm"
    error_um = depth_um - target_um
    label = f"depth − {against.partition(' ')[0]} (µm)"
    figure, (errors, wear) = style.panels(
        style.Block("hole, in the order of machining; bars: 95 %", {label: 1.25, "tool wear (µm)": 1.0}),
        width_mm=PAGE_MM,
        left_mm=LEFT_MM + MAP_MM + BAR_MM + LEFT_MM,
    )
    low, high = wear.get_position().y0, errors.get_position().y1
    places = figure.add_axes((LEFT_MM / PAGE_MM, low, MAP_MM / PAGE_MM, high - low))
    style.letter_panels((places, errors, wear))
    _draw_map(places, sites, error_um, tolerance_um, label)
    _draw_errors(errors, sites, error_um, tolerance_um, against)
    _draw_wear(wear, sites)
    return figure


def _holes(run: RunFile) -> list[RecordedSite]:
    """Return the holes with a depth, in the order of machining."""
    if "path.kind" in run.profile_values():
        raise NothingToDraw("The run made a channel, no holes: `--kind channel` draws it.")
    sites = [site for site in numbers_of(run).sites if np.isfinite(site.length_um)]
    if not sites:
        raise NothingToDraw("No hole was measured: the run ended before its first measuring stop.")
    sites = [site for site in sites if not site.through]
    if not sites:
        raise NothingToDraw("The holes go through the sheet: there are no depths to compare.")
    if len(sites) == 1:
        raise NothingToDraw("The run made one hole: `--kind steps` and `--kind erosion` draw it.")
    return sites


def short_names(names: Sequence[str]) -> list[str]:
    """Return the numbers of names that differ in nothing else, else the names."""
    parts = [name.rpartition("-") for name in names]
    alike = len({head for head, _, _ in parts}) == 1 and all(number.isdecimal() for _, _, number in parts)
    return [number for _, _, number in parts] if alike else list(names)


def _draw_map(
    axes: Axes, sites: Sequence[RecordedSite], error_um: Array, tolerance_um: float, label: str
) -> None:
    places_um = np.array([(site.x_um, site.y_um) for site in sites])
    least_um = tolerance_um if np.isfinite(tolerance_um) else LEAST_SPAN_UM
    span_um = max(least_um, float(np.abs(error_um).max()))
    apart_um = np.hypot(*(places_um[:, None] - places_um).T)
    pitch_um = float(apart_um[apart_um > 1.0].min()) if (apart_um > 1.0).any() else 100.0
    middle_um = 0.5 * (places_um.min(axis=0) + places_um.max(axis=0))
    half_um = 0.5 * np.ptp(places_um, axis=0) + 0.62 * pitch_um
    # A row of holes shall not become a strip that is too narrow to read.
    half_um = np.maximum(half_um, 0.35 * half_um.max())
    axes.set_xlim(middle_um[0] - half_um[0], middle_um[0] + half_um[0])
    axes.set_ylim(middle_um[1] - half_um[1], middle_um[1] + half_um[1])
    axes.set_aspect("equal")
    discs = PatchCollection(
        [Circle((x_um, y_um), 0.42 * pitch_um) for x_um, y_um in places_um], edgecolor=BLACK, linewidth=0.5
    )
    discs.set(array=error_um, cmap=style.DEVIATIONS, norm=Normalize(-span_um, span_um))
    axes.add_collection(discs)
    if len(sites) <= LABELLED:
        names = short_names([site.name for site in sites])
        for name, site, hole_um in zip(names, sites, error_um, strict=True):
            u95_um = float(np.nan_to_num(site.depth_u95_um))
            axes.text(
                site.x_um, site.y_um, f"{name}\n{marked(signed(hole_um), site.depth_basis)}\n± {u95_um:.2f}",
                ha="center", va="center", fontsize=6.0 if len(sites) <= 16 else 4.5, linespacing=1.15,
                color="white" if abs(hole_um) > 0.6 * span_um else BLACK,
            )  # fmt: skip
    axes.locator_params(nbins=6)
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    style.add_colours(axes, discs, label)
    bases = {site.depth_basis for site in sites}
    marks = [text for basis, text in _MARKS.items() if basis in bases]
    style.note_above(axes, "; ".join([*marks, "discs mark places, not sizes"]))


def _draw_errors(
    axes: Axes, sites: Sequence[RecordedSite], error_um: Array, tolerance_um: float, against: str
) -> None:
    known = np.isfinite(tolerance_um)
    if known:
        axes.axhspan(-tolerance_um, tolerance_um, color=style.TOLERANCE, linewidth=0.0, zorder=0)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    bases = [site.depth_basis or "" for site in sites]
    _points(axes, error_um, [site.depth_u95_um for site in sites], bases, BLUE, "o")
    style.note_above(axes, f"{against}, ± {tolerance_um:g} µm shaded" if known else against)


def _draw_wear(axes: Axes, sites: Sequence[RecordedSite]) -> None:
    bases = [site.wear_basis or "" for site in sites]
    wear_um = np.array([site.wear_um for site in sites])
    _points(axes, wear_um, [site.wear_u95_um for site in sites], bases, VERMILION, "s")
    style.note_above(axes, open_marks([*bases, *(site.depth_basis or "" for site in sites)]))
    names = short_names([site.name for site in sites])
    every = -(-len(names) // MOST_TICKS)
    axes.set_xticks(range(1, len(names) + 1, every), names[::every])
    if max(map(len, names)) > LONGEST_LEVEL:
        axes.tick_params(axis="x", labelrotation=90)
        figure = axes.get_figure(root=True)
        assert figure is not None
        style.grow(figure, below_mm=1.3 * max(map(len, names)))
        axes.xaxis.labelpad = 1.0
    axes.set_xlim(0.4, len(sites) + 0.6)


def _points(
    axes: Axes, values: Array, u95: Sequence[float], bases: Sequence[str], colour: str, mark: str
) -> None:
    """Draw values with their bars by the numbers of the holes, open if they were not touched with a sensor."""
    size = 3.4 if len(values) <= 30 else 2.2
    number, bars = np.arange(1, len(values) + 1), np.nan_to_num(u95)
    hollow = np.array([is_open(basis) for basis in bases], np.bool_)
    for some, full in ((~hollow, True), (hollow, False)):
        if some.any():
            style.draw_points(
                axes, number[some], values[some], bars[some], colour, full=full, marker=mark, size=size
            )
