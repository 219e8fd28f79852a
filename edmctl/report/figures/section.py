"""The hole in section, as a microscope shows it cut through its middle, with the tool that made it.

Like Fig. 10 of Muralidhara et al. 2009, where holes were cut open. Depth and wear are those that were touched; no
touch tells how wide a hole is, so that its walls stand where the profile's side gap has them. The working gap is
that between the floor and the tip where it sparked last. What the virtual machine knows of its own hole is a line of
its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, marked
from edmctl.report.numbers import numbers_of
from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    FAINT,
    GREEN,
    GREY,
    LIGHT,
    PAGE_MM,
    VERMILION,
    Dash,
    NothingToDraw,
    new_figure,
)
from edmctl.results.run_file import RecordedSite
from edmctl.wording import BEYOND_EXIT, plain_number, with_u95

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

HEIGHT_MM = 92.0
"""Greatest height of the figure."""
BESIDE_MM, AROUND_MM = 13.0, 40.0
"""Width of the axis labels beside a panel, and height of legend and words around it."""
MOST_HOLES = 3
"""As many fit side by side; of more, the last ones are drawn."""
TALLEST, FLATTEST = 1.3, 0.45
"""Height over width between which a section is drawn to scale."""
SCALES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
ARC_POINTS = 12
_FLOORS: dict[str, tuple[str, Dash]] = {
    Basis.TOUCHED: ("floor, touched", "-"),
    Basis.MODEL: ("floor, touched, by the actuator's model", "-"),
    Basis.ESTIMATED: ("floor, estimated", (0, (1.0, 0.8))),
}


@dataclass(frozen=True, slots=True)
class Section:
    """What is drawn of a hole; lengths in µm, NaN where nothing is known.

    side_gap_um : of the profile; what it says where nobody measured it
    sheet_um : thickness of the sheet that the hole goes through; NaN of a blind one
    """

    site: RecordedSite
    tool_diameter_um: float
    side_gap_um: float
    sheet_um: float

    @property
    def wall_um(self) -> float:
        """Where the wall is by the profile, from the middle; at the tool without a side gap."""
        return 0.5 * self.tool_diameter_um + (self.side_gap_um if math.isfinite(self.side_gap_um) else 0.0)

    @property
    def end_um(self) -> float:
        """Where the hole ends below the face: at its floor, or at the other face of the sheet."""
        return self.sheet_um if self.site.through else self.site.depth_um

    @property
    def tip_um(self) -> float:
        """Where the tip of the tool is in the end, below the surface."""
        return self.sheet_um + self.site.beyond_exit_um if self.site.through else self.site.depth_um

    @property
    def lost_um(self) -> float:
        """What the tool has lost, 0 where it is not known."""
        return self.site.wear_um if math.isfinite(self.site.wear_um) else 0.0

    def true_outline(self) -> Array | None:
        """Return the true hole from mouth to mouth, shape (n, 2) of across and depth; None without a truth.

        Walls are straight between mouth and floor; the edge of the floor is round.
        """
        site = self.site
        gap_um, depth_um = site.truth.side_gap_um, self.sheet_um if site.through else site.truth.depth_um
        if not (math.isfinite(gap_um) and math.isfinite(depth_um)):
            return None
        low_um = 0.5 * self.tool_diameter_um + gap_um
        mouth_um = low_um + (site.truth.taper_um if math.isfinite(site.truth.taper_um) else 0.0)
        if site.through:
            half = np.array([[mouth_um, 0.0], [low_um, depth_um], [math.nan, math.nan]])
        else:
            corner_um = site.truth.corner_um if math.isfinite(site.truth.corner_um) else 0.0
            corner_um = min(corner_um, low_um, depth_um)
            half = np.vstack([[mouth_um, 0.0], _rounded(low_um, depth_um, corner_um)])
        mirrored = half[::-1] * [-1.0, 1.0]
        outline: Array = np.vstack([half, mirrored])
        return outline

    def tool_tip(self) -> Array:
        """Return the end of the tool from right to left, shape (n, 2) of across and depth.

        Its edge is as round as that of the true floor, and square if that is unknown.
        """
        radius_um, corner_um = 0.5 * self.tool_diameter_um, self.site.truth.corner_um
        corner_um = 0.0 if self.site.through or not math.isfinite(corner_um) else corner_um
        half = _rounded(radius_um, self.tip_um, min(corner_um, radius_um))
        tip: Array = np.vstack([half, half[::-1] * [-1.0, 1.0]])
        return tip


def draw(run: RunFile) -> Figure:
    """Draw the last holes of the run: one 85 mm wide, up to three 180 mm. Raises NothingToDraw."""
    sections, count = _sections(run)
    alone = len(sections) == 1
    width_mm = COLUMN_MM if alone else PAGE_MM
    panel_mm = (width_mm / len(sections) - BESIDE_MM) * max(map(_drawn_ratio, sections))
    figure = new_figure(min(HEIGHT_MM, AROUND_MM + panel_mm), width_mm)
    panels = figure.subplots(1, len(sections), squeeze=False)[0]
    named: dict[str, Artist] = {}
    first = count - len(sections) + 1
    for place, (axes, section) in enumerate(zip(panels, sections, strict=True)):
        # The letter is part of the title: beside one so long there is no room for it.
        letter = "" if alone else f"({'abc'[place]}) "
        of_all = "" if count == 1 else f" ({first + place} of {count})"
        _draw_section(axes, section, f"{letter}{section.site.name}{of_all}")
        handles, names = axes.get_legend_handles_labels()
        named.update(zip(names, handles, strict=True))
    panels[0].set_ylabel("below the face (µm)")
    figure.legend(
        named.values(),
        named,
        loc="outside upper center",
        ncols=2 if alone else 4,
        handlelength=1.8,
        columnspacing=1.0,
    )
    return figure


def _sections(run: RunFile) -> tuple[list[Section], int]:
    """Return what is drawn, and how many holes there are."""
    values = run.profile_values()
    if "path.kind" in values:
        raise NothingToDraw("The run made a channel, no hole: `--kind channel` draws it.")
    sites = [site for site in numbers_of(run).sites if math.isfinite(site.length_um)]
    if not sites:
        raise NothingToDraw(
            "No hole of this run has a depth, so there is no section; a job that reaches its first measuring stop "
            "has one."
        )
    diameter_um = run.number("/entry/tool/diameter")
    if not diameter_um > 0.0:
        raise NothingToDraw(
            "This file does not say how thick the tool was, and the hole is as wide: that stands in run files of "
            "jobs with a profile (tool.diameter_um)."
        )
    gap_um, sheet_um = plain_number(values.get("work.side_gap_um")), run.number("/entry/sample/thickness")
    return [Section(site, diameter_um, gap_um, sheet_um) for site in sites[-MOST_HOLES:]], len(sites)


def _draw_section(axes: Axes, section: Section, title: str) -> None:
    outline, widest_um = section.true_outline(), _widest_um(section)
    left_um, right_um, bottom_um, top_um = _ends(section)
    _draw_work(axes, section, (left_um, right_um), bottom_um)
    _draw_tool(axes, section, top_um)
    if outline is not None:
        axes.plot(*outline.T, color=GREEN, linewidth=1.0, label="truth (simulated)", zorder=4.0)
    _draw_lengths(axes, section, 1.12 * widest_um)
    scale = _scale((bottom_um - top_um) / (right_um - left_um))
    axes.set_xlim(left_um, right_um)
    axes.set_ylim(bottom_um, top_um)
    axes.set_aspect(scale, anchor="N")
    axes.grid(visible=False)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(title if scale == 1.0 else f"{title}, depth × {scale:g}", pad=2.0)
    axes.set_xlabel("\n".join(["across (µm)", *_words(section)]))


def _widest_um(section: Section) -> float:
    outline = section.true_outline()
    return section.wall_um if outline is None else max(section.wall_um, float(np.nanmax(outline[:, 0])))


def _ends(section: Section) -> tuple[float, float, float, float]:
    """Return the left, right, lower and upper end of what is shown, µm."""
    widest_um = _widest_um(section)
    lowest_um = max(section.end_um, section.tip_um + section.lost_um)
    return -1.35 * widest_um, 2.7 * widest_um, 1.16 * lowest_um, -0.28 * lowest_um


def _drawn_ratio(section: Section) -> float:
    """Height over width of what is shown, as it is drawn."""
    left_um, right_um, bottom_um, top_um = _ends(section)
    ratio = (bottom_um - top_um) / (right_um - left_um)
    return ratio * _scale(ratio)


def _draw_work(axes: Axes, section: Section, ends_um: tuple[float, float], bottom_um: float) -> None:
    """The work with the hole as touches and profile have it."""
    site, wall_um, end_um = section.site, section.wall_um, section.end_um
    below_um = section.sheet_um if site.through else bottom_um
    for left_um, right_um in ((ends_um[0], -wall_um), (wall_um, ends_um[1])):
        axes.fill(
            [left_um, right_um, right_um, left_um], [0.0, 0.0, below_um, below_um], color=LIGHT, linewidth=0.0
        )
    for side in (-1.0, 1.0):
        label = "wall by the profile's side gap" if side > 0.0 and math.isfinite(section.side_gap_um) else "_"
        axes.plot(
            [side * wall_um] * 2,
            [0.0, end_um],
            color=FAINT,
            linewidth=0.8,
            linestyle=(0, (3.0, 1.5)),
            label=label,
        )
        axes.plot([side * wall_um, ends_um[0 if side < 0.0 else 1]], [0.0, 0.0], color=BLACK, linewidth=0.8)
    if site.through:
        return
    axes.fill(
        [-wall_um, wall_um, wall_um, -wall_um],
        [end_um, end_um, below_um, below_um],
        color=LIGHT,
        linewidth=0.0,
    )
    label, dash = _FLOORS.get(site.depth_basis or "", ("floor", "-"))
    axes.plot(
        [-wall_um, wall_um],
        [end_um, end_um],
        color=BLACK,
        linewidth=1.4,
        linestyle=dash,
        label=label,
        zorder=3.0,
    )
    if math.isfinite(site.depth_u95_um):
        axes.axhspan(
            end_um - site.depth_u95_um, end_um + site.depth_u95_um,
            xmin=_share(-wall_um, ends_um), xmax=_share(wall_um, ends_um), color=BLUE, alpha=0.25, linewidth=0.0,
            zorder=2.5,
        )  # fmt: skip


def _draw_tool(axes: Axes, section: Section, top_um: float) -> None:
    """The tool with its tip where it touched last, and what it was longer before."""
    radius_um, tip_um, tip = 0.5 * section.tool_diameter_um, section.tip_um, section.tool_tip()
    across = [-radius_um, radius_um]
    axes.fill(
        [*across, *tip[:, 0]],
        [top_um, top_um, *tip[:, 1]],
        facecolor=GREY,
        alpha=0.45,
        linewidth=0.0,
        label="tool at the end" if section.site.through else "tool at the bottom",
    )
    gap_um = math.nan if section.site.through else section.site.working_gap_um
    if math.isfinite(gap_um):
        axes.plot(
            across, [tip_um - gap_um] * 2, color=GREY, linewidth=0.8, linestyle=(0, (1.0, 1.0)),
            label="tip while sparking",
        )  # fmt: skip
    if section.lost_um > 0.0:
        lost_um = tip_um + section.lost_um
        axes.fill(
            [*tip[:, 0], *across], [*tip[:, 1], lost_um, lost_um], facecolor="none", edgecolor=VERMILION,
            hatch="/////", linewidth=0.6, linestyle=":", label="worn off the tool",
        )  # fmt: skip


def _draw_lengths(axes: Axes, section: Section, at_um: float) -> None:
    """Arrows of depth and wear beside the hole, with their numbers."""
    site = section.site
    lengths: list[tuple[str, float, float, str]]
    if site.through:
        beyond = with_u95(site.beyond_exit_um, site.beyond_exit_u95_um, 1)
        words = BEYOND_EXIT.replace(" the", "\nthe")
        lengths = [(f"{words}\n{beyond} µm", section.end_um, section.tip_um, BLUE)]
    else:
        depth = marked(with_u95(site.depth_um, site.depth_u95_um, 1), site.depth_basis)
        lengths = [(f"depth\n{depth} µm", 0.0, site.depth_um, BLUE)]
    if math.isfinite(site.wear_um):
        wear = marked(with_u95(site.wear_um, site.wear_u95_um, 1), site.wear_basis)
        lengths.append((f"wear\n{wear} µm", section.tip_um, section.tip_um + site.wear_um, VERMILION))
    for words, begin_um, end_um, colour in lengths:
        arrow = {"arrowstyle": "<|-|>,head_length=0.28,head_width=0.14", "color": colour, "linewidth": 0.8}
        axes.annotate(
            "",
            xy=(at_um, end_um),
            xytext=(at_um, begin_um),
            arrowprops={**arrow, "shrinkA": 0.0, "shrinkB": 0.0},
        )
        axes.annotate(
            words, (at_um, 0.5 * (begin_um + end_um)), xytext=(3.0, 0.0), textcoords="offset points",
            color=colour, va="center", fontsize=6.0,
        )  # fmt: skip


def _words(section: Section) -> list[str]:
    """What is known of the gaps, and from where."""
    site = section.site
    lines = [
        f"{words} {value_um:.1f} µm"
        for words, value_um in (
            ("working gap", math.nan if site.through else site.working_gap_um),
            ("side gap by the profile", section.side_gap_um),
        )
        if math.isfinite(value_um)
    ]
    truth = [
        f"{words} {value_um:.1f} µm"
        for words, value_um in (
            ("side gap", site.truth.side_gap_um),
            ("taper", site.truth.taper_um),
            ("corner", site.truth.corner_um),
        )
        if math.isfinite(value_um)
    ]
    if truth:
        lines += [f"truth: {truth[0]}", ", ".join(truth[1:])]
    return lines


def _rounded(across_um: float, depth_um: float, corner_um: float) -> Array:
    """Return a corner of that radius below a vertical wall, shape (ARC_POINTS, 2) of across and depth."""
    angle = np.linspace(0.0, 0.5 * math.pi, ARC_POINTS)
    arc: Array = np.column_stack(
        [across_um - corner_um * (1.0 - np.cos(angle)), depth_um - corner_um * (1.0 - np.sin(angle))]
    )
    return arc


def _scale(height_over_width: float) -> float:
    """How much depths are stretched, so that a section is neither a line nor a needle; 1 where it need not."""
    if FLATTEST <= height_over_width <= TALLEST:
        return 1.0
    middle = math.sqrt(FLATTEST * TALLEST)
    return min(SCALES, key=lambda scale: abs(math.log(scale * height_over_width / middle)))


def _share(at_um: float, ends_um: Sequence[float]) -> float:
    return (at_um - ends_um[0]) / (ends_um[1] - ends_um[0])
