"""Holes: the depth error of each at its place in an array, and the last ones in section.

A section shows a hole cut through its middle, like Fig. 10 of Muralidhara et al. 2009, with the tool that made it.
Depth and wear are measured by contact; the width is not measured: walls are drawn from the profile's side gap. The
working gap is that between the floor and the tip during the last sparks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, is_open, marked, open_marks
from edmctl.record.reader import RunFile, sites_of
from edmctl.report import panels
from edmctl.report.panels import Block
from edmctl.results.job import length_text
from edmctl.results.run_file import RecordedSite
from edmctl.wording import BEYOND_EXIT, plain_number, signed, with_u95

_MARKS = {Basis.MODEL: " by model", Basis.ESTIMATED: " not touched"}
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

GAP_MM = 9.0
LINE_MM = 3.3
"""Height of a line of words below a section."""
MOST_HOLES = 3
"""As many fit side by side; of more, the last ones are drawn."""
TALLEST, FLATTEST = 1.0, 0.45
"""Height over width between which a section is drawn to scale."""
SCALES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
ARC_POINTS = 12
_FLOORS: dict[str, tuple[str, panels.Dash]] = {
    Basis.TOUCHED: ("floor, touched", "-"),
    Basis.MODEL: ("floor, touched, by the actuator's model", "-"),
    Basis.ESTIMATED: ("floor, estimated", (0, (1.0, 0.8))),
}


def draw_array(run: RunFile) -> Figure:
    """Draw the holes to scale, coloured by depth minus target; without a target depth, minus their mean."""
    sites = [site for site in _measured_holes(run) if not site.through]
    if not sites:
        raise panels.NothingToDraw("The holes go through the sheet: there are no depths to compare.")
    if len(sites) == 1:
        raise panels.NothingToDraw("The run made one hole: `--kind steps` and `--kind erosion` draw it.")
    values = run.profile_values()
    target_um, tolerance_um = plain_number(values.get("target.depth_um")), math.nan
    depth_um = np.array([site.depth_um for site in sites])
    against, label = f"target {target_um:g} µm", "depth − target (µm)"
    if math.isfinite(target_um):
        tolerance_um = plain_number(values.get("target.tolerance_um"))
    else:
        target_um = float(depth_um.mean())
        against, label = f"mean {target_um:.2f} µm", "depth − mean (µm)"
    error_um = depth_um - target_um
    figure, (errors, wear) = panels.panels(
        Block("hole, in the order of machining; bars: 95 %", {label: 1.25, "tool wear (µm)": 1.0}),
        width_mm=panels.PAGE_MM,
        left_mm=panels.LEFT_MM + MAP_MM + BAR_MM + panels.LEFT_MM,
    )
    low, high = wear.get_position().y0, errors.get_position().y1
    places = figure.add_axes((panels.LEFT_MM / panels.PAGE_MM, low, MAP_MM / panels.PAGE_MM, high - low))
    panels.letter_panels((places, errors, wear))
    _draw_map(places, sites, error_um, tolerance_um, label)
    bases = [site.depth_basis or "" for site in sites]
    if math.isfinite(tolerance_um):
        errors.axhspan(-tolerance_um, tolerance_um, color=panels.TOLERANCE, linewidth=0.0, zorder=0)
        against += f", ± {tolerance_um:g} µm shaded"
    errors.axhline(0.0, color=panels.GREY, linewidth=0.6)
    _draw_in_order(errors, error_um, [site.depth_u95_um for site in sites], bases, panels.BLUE, "o")
    panels.note_above(errors, against)
    wear_um, wear_bases = np.array([site.wear_um for site in sites]), [site.wear_basis for site in sites]
    _draw_in_order(wear, wear_um, [site.wear_u95_um for site in sites], wear_bases, panels.VERMILION, "s")
    panels.note_above(wear, open_marks([*wear_bases, *bases]))
    names = short_names([site.name for site in sites])
    every, longest = -(-len(names) // MOST_TICKS), max(map(len, names))
    wear.set_xticks(range(1, len(names) + 1, every), names[::every])
    if longest > LONGEST_LEVEL:
        wear.tick_params(axis="x", rotation=90)
        panels.grow(figure, below_mm=1.3 * longest)
        wear.xaxis.labelpad = 1.0
    wear.set_xlim(0.4, len(names) + 0.6)
    return figure


def _measured_holes(run: RunFile) -> list[RecordedSite]:
    """Return the holes with a length, in the order of machining. Raises NothingToDraw."""
    if "path.kind" in run.profile_values():
        raise panels.NothingToDraw("The run made a channel, no holes: `--kind channel` draws it.")
    sites = [site for site in sites_of(run) if math.isfinite(site.length_um)]
    if not sites:
        raise panels.NothingToDraw("No hole was measured: the run ended before its first measuring stop.")
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
    least_um = tolerance_um if math.isfinite(tolerance_um) else LEAST_SPAN_UM
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
        [Circle((x_um, y_um), 0.42 * pitch_um) for x_um, y_um in places_um],
        edgecolor=panels.BLACK,
        linewidth=0.5,
    )
    discs.set(array=error_um, cmap=panels.DEVIATIONS, norm=Normalize(-span_um, span_um))
    axes.add_collection(discs)
    if len(sites) <= LABELLED:
        names = short_names([site.name for site in sites])
        for name, site, hole_um in zip(names, sites, error_um, strict=True):
            u95_um = _known(site.depth_u95_um)
            axes.text(
                site.x_um, site.y_um, f"{name}\n{marked(signed(hole_um), site.depth_basis)}\n± {u95_um:.2f}",
                ha="center", va="center", fontsize=6.0 if len(sites) <= 16 else 4.5, linespacing=1.15,
                color="white" if abs(hole_um) > 0.6 * span_um else panels.BLACK,
            )  # fmt: skip
    axes.locator_params(nbins=6)
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    panels.add_colours(axes, discs, label)
    bases = {site.depth_basis for site in sites}
    marks = [marked(text, basis) for basis, text in _MARKS.items() if basis in bases]
    panels.note_above(axes, "; ".join([*marks, "discs mark places, not sizes"]))


def _draw_in_order(
    axes: Axes, values: Array, u95: Sequence[float], bases: Sequence[str], colour: str, marker: str
) -> None:
    """Draw values with their bars by the numbers of the holes, open if they were not touched with a sensor."""
    size = 3.4 if len(values) <= 30 else 2.2
    number, bars = np.arange(1, len(values) + 1), np.nan_to_num(u95)
    hollow = np.array([is_open(basis) for basis in bases], np.bool_)
    for some, full in ((~hollow, True), (hollow, False)):
        if some.any():
            panels.draw_points(
                axes, number[some], values[some], bars[some], colour, full=full, marker=marker, size=size
            )


@dataclass(frozen=True, slots=True)
class Section:
    """A hole as it is drawn; lengths in µm, NaN if unknown.

    radius_um : of the tool
    side_gap_um : of the profile
    sheet_um : thickness of the sheet that the hole goes through; NaN of a blind one
    """

    site: RecordedSite
    radius_um: float
    side_gap_um: float
    sheet_um: float

    @property
    def wall_um(self) -> float:
        """Distance of the wall from the middle by the profile; the tool's radius without a side gap."""
        return self.radius_um + _known(self.side_gap_um)

    @property
    def end_um(self) -> float:
        return self.sheet_um if self.site.through else self.site.depth_um

    @property
    def tip_um(self) -> float:
        """Position of the tip of the tool at the end, below the surface."""
        return self.sheet_um + self.site.beyond_exit_um if self.site.through else self.site.depth_um

    @property
    def worn_um(self) -> float:
        return self.tip_um + _known(self.site.wear_um)

    def true_outline(self) -> Array | None:
        """Return the true hole from mouth to mouth, shape (n, 2) of across and depth; None without a truth."""
        truth, through = self.site.truth, self.site.through
        gap_um, depth_um = truth.side_gap_um, self.sheet_um if through else truth.depth_um
        if not (math.isfinite(gap_um) and math.isfinite(depth_um)):
            return None
        low_um = self.radius_um + gap_um
        mouth_um = low_um + _known(truth.taper_um)
        if through:
            return _mirrored([[mouth_um, 0.0], [low_um, depth_um], [math.nan, math.nan]])
        corner_um = min(_known(truth.corner_um), low_um, depth_um)
        return _mirrored([[mouth_um, 0.0], *_rounded(low_um, depth_um, corner_um)])

    def tool_tip(self) -> Array:
        """Return the end of the tool, shape (n, 2) of across and depth, as round as the edge of the true floor."""
        corner_um = 0.0 if self.site.through else _known(self.site.truth.corner_um)
        return _mirrored(_rounded(self.radius_um, self.tip_um, min(corner_um, self.radius_um)))

    def limits_um(self) -> tuple[float, float, float, float]:
        """Return the left, right, lower and upper end of what is shown, µm."""
        outline = self.true_outline()
        widest_um = max(self.wall_um, float(np.nanmax(outline[:, 0])) if outline is not None else 0.0)
        lowest_um = max(self.end_um, self.worn_um)
        return -1.35 * widest_um, 2.7 * widest_um, 1.16 * lowest_um, -0.28 * lowest_um

    def scaled(self) -> tuple[float, float]:
        """Return by how much depths are stretched, and height over width as they are drawn then."""
        left_um, right_um, bottom_um, top_um = self.limits_um()
        ratio = (bottom_um - top_um) / (right_um - left_um)
        return scale_of(ratio), ratio * scale_of(ratio)

    def words(self) -> list[str]:
        """Return the gaps and their sources, line by line."""
        site, truth = self.site, self.site.truth
        values = {
            "working gap": math.nan if site.through else site.working_gap_um,
            "side gap by the profile": self.side_gap_um,
            "truth: side gap": truth.side_gap_um,
            "taper": truth.taper_um,
            "corner": truth.corner_um,
        }
        texts = {name: f"{name} {um:.1f} µm" for name, um in values.items() if math.isfinite(um)}
        shape = [texts.pop(name) for name in ("taper", "corner") if name in texts]
        return [*texts.values(), ", ".join(shape)]


def draw_section(run: RunFile) -> Figure:
    """Draw the last holes of the run: one in a column, up to three over a page. Raises NothingToDraw."""
    sections, count = sections_of(run)
    alone = len(sections) == 1
    width_mm = panels.COLUMN_MM if alone else panels.PAGE_MM
    inner_mm = width_mm - panels.LEFT_MM - panels.RIGHT_MM - GAP_MM * (len(sections) - 1)
    height_mm = inner_mm / len(sections) * max(section.scaled()[1] for section in sections)
    figure, axes_of = panels.panels(
        Block("", {"below the face (µm)": height_mm / panels.PANEL_MM}, (1.0,) * len(sections)),
        width_mm=width_mm,
        gap_mm=GAP_MM,
    )
    panels.grow(figure, below_mm=LINE_MM * max(len(section.words()) for section in sections))
    first = count - len(sections) + 1
    for place, (axes, section) in enumerate(zip(axes_of, sections, strict=True)):
        # The letter is part of the title: beside one so long there is no room for it.
        letter = "" if alone else f"({'abc'[place]}) "
        of_all = "" if count == 1 else f" ({first + place} of {count})"
        axes.set_title("", loc="left")
        _draw_hole(axes, section, f"{letter}{section.site.name}{of_all}")
    panels.shared_legend(figure, axes_of, ncols=2 if alone else 4)
    return figure


def sections_of(run: RunFile) -> tuple[list[Section], int]:
    """Return the holes to draw, and how many there are."""
    values, sites = run.profile_values(), _measured_holes(run)
    diameter_um = run.number("/entry/tool/diameter")
    if not diameter_um > 0.0:
        raise panels.NothingToDraw(
            "The width of the tool is not in this file, and the hole is as wide; run files of jobs with a profile "
            "have it (tool.diameter_um)."
        )
    gap_um, sheet_um = plain_number(values.get("work.side_gap_um")), run.number("/entry/sample/thickness")
    return [Section(site, 0.5 * diameter_um, gap_um, sheet_um) for site in sites[-MOST_HOLES:]], len(sites)


def _draw_hole(axes: Axes, section: Section, title: str) -> None:
    left_um, right_um, bottom_um, top_um = section.limits_um()
    scale, _ = section.scaled()
    axes.set_xlim(left_um, right_um)
    axes.set_ylim(bottom_um, top_um)
    _draw_work(axes, section)
    _draw_tool(axes, section)
    outline = section.true_outline()
    if outline is not None:
        axes.plot(*outline.T, color=panels.GREEN, linewidth=1.0, label="truth (simulated)", zorder=4.0)
    _draw_lengths(axes, section, 0.415 * right_um)
    axes.set_aspect(scale, anchor="N")
    axes.grid(visible=False)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(title if scale == 1.0 else f"{title}, depth × {scale:g}", pad=2.0)
    axes.set_xlabel("\n".join(["across (µm)", *section.words()]))


def _draw_work(axes: Axes, section: Section) -> None:
    """Draw the workpiece with the hole by touches and profile."""
    site, wall_um, end_um = section.site, section.wall_um, section.end_um
    (left_um, right_um), (bottom_um, _) = axes.get_xlim(), axes.get_ylim()
    below_um = section.sheet_um if site.through else bottom_um
    label = "wall by the profile's side gap" if math.isfinite(section.side_gap_um) else "_"
    for inner_um, outer_um, name in ((-wall_um, left_um, "_"), (wall_um, right_um, label)):
        axes.fill_between([inner_um, outer_um], 0.0, below_um, color=panels.LIGHT, linewidth=0.0)
        axes.plot([inner_um] * 2, [0.0, end_um], color=panels.FAINT, linestyle=(0, (3.0, 1.5)), label=name)
        axes.plot([inner_um, outer_um], [0.0, 0.0], color=panels.BLACK)
    if site.through:
        return
    across_um = [-wall_um, wall_um]
    axes.fill_between(across_um, end_um, below_um, color=panels.LIGHT, linewidth=0.0)
    label, dash = _FLOORS.get(site.depth_basis or "", ("floor", "-"))
    axes.plot(
        across_um, [end_um] * 2, color=panels.BLACK, linewidth=1.4, linestyle=dash, label=label, zorder=3.0
    )
    if math.isfinite(site.depth_u95_um):
        low_um, high_um = end_um - site.depth_u95_um, end_um + site.depth_u95_um
        axes.fill_between(
            across_um, low_um, high_um, color=panels.BLUE, alpha=0.25, linewidth=0.0, zorder=2.5
        )


def _draw_tool(axes: Axes, section: Section) -> None:
    """Draw the tool with its tip at the last touch, the working gap and the wear."""
    site, tip, top_um = section.site, section.tool_tip(), axes.get_ylim()[1]
    across = [-section.radius_um, section.radius_um]
    axes.fill(
        [*across, *tip[:, 0]], [top_um, top_um, *tip[:, 1]], facecolor=panels.GREY, alpha=0.45, linewidth=0.0,
        label="tool at the end" if site.through else "tool at the bottom",
    )  # fmt: skip
    if math.isfinite(site.working_gap_um) and not site.through:
        gap_um = section.tip_um - site.working_gap_um
        axes.plot(
            across, [gap_um] * 2, color=panels.GREY, linestyle=(0, (1.0, 1.0)), label="tip while sparking"
        )
    if section.worn_um > section.tip_um:
        axes.fill(
            [*tip[:, 0], *across], [*tip[:, 1], section.worn_um, section.worn_um], facecolor="none",
            edgecolor=panels.VERMILION, hatch="/////", linewidth=0.6, linestyle=":", label="worn off the tool",
        )  # fmt: skip


def _draw_lengths(axes: Axes, section: Section, at_um: float) -> None:
    """Draw arrows of depth and wear beside the hole, with their numbers."""
    site, begin_um, words = section.site, 0.0, f"depth\n{length_text(section.site, 'depth', 1)}"
    if site.through:
        begin_um, words = section.end_um, BEYOND_EXIT.replace(" the", "\nthe")
        words += f"\n{with_u95(site.beyond_exit_um, site.beyond_exit_u95_um, 1)}"
    panels.draw_length(axes, at_um, (begin_um, section.tip_um), panels.BLUE, f"{words} µm")
    if math.isfinite(site.wear_um):
        ends_um, words = (section.tip_um, section.worn_um), f"wear\n{length_text(site, 'wear', 1)} µm"
        panels.draw_length(axes, at_um, ends_um, panels.VERMILION, words)


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _mirrored(half: Sequence[Sequence[float]] | Array) -> Array:
    """Return an outline with its mirror image on the left."""
    right: Array = np.array(half)
    return np.vstack([right, right[::-1] * [-1.0, 1.0]])


def _rounded(across_um: float, depth_um: float, corner_um: float) -> Array:
    """Return a corner of that radius below a vertical wall, shape (ARC_POINTS, 2) of across and depth."""
    angle = np.linspace(0.0, 0.5 * math.pi, ARC_POINTS)
    return np.column_stack(
        [across_um - corner_um * (1.0 - np.cos(angle)), depth_um - corner_um * (1.0 - np.sin(angle))]
    )


def scale_of(height_over_width: float) -> float:
    """Return by how much depths are stretched, so that a section is neither a line nor a needle; often 1."""
    if FLATTEST <= height_over_width <= TALLEST:
        return 1.0
    middle = math.sqrt(FLATTEST * TALLEST)
    return min(SCALES, key=lambda scale: abs(math.log(scale * height_over_width / middle)))
