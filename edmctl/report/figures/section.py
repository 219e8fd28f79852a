"""The hole in section, as a microscope shows it cut through its middle, with the tool that made it.

Like Fig. 10 of Muralidhara et al. 2009, where holes were cut open. Depth and wear are those that were touched; the
width is not measured: walls are drawn from the profile's side gap. The working gap is that between the floor and the
tip during the last sparks. The true hole of a virtual machine is a line of its own.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, marked
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.numbers import numbers_of
from edmctl.report.style import BLACK, BLUE, FAINT, GREEN, GREY, LIGHT, VERMILION, Dash, NothingToDraw
from edmctl.results.run_file import RecordedSite
from edmctl.wording import BEYOND_EXIT, plain_number, with_u95

GAP_MM = 9.0
LINE_MM = 3.3
"""Height of a line of words below a section."""
MOST_HOLES = 3
"""As many fit side by side; of more, the last ones are drawn."""
TALLEST, FLATTEST = 1.0, 0.45
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
    """A hole as it is drawn; lengths in µm, NaN if unknown.

    side_gap_um : of the profile
    sheet_um : thickness of the sheet that the hole goes through; NaN of a blind one
    """

    site: RecordedSite
    tool_diameter_um: float
    side_gap_um: float
    sheet_um: float

    @property
    def radius_um(self) -> float:
        """Radius of the tool."""
        return 0.5 * self.tool_diameter_um

    @property
    def wall_um(self) -> float:
        """Distance of the wall from the middle by the profile; the tool's radius without a side gap."""
        return self.radius_um + (self.side_gap_um if math.isfinite(self.side_gap_um) else 0.0)

    @property
    def end_um(self) -> float:
        """End of the hole below the face: its floor, or the other face of the sheet."""
        return self.sheet_um if self.site.through else self.site.depth_um

    @property
    def tip_um(self) -> float:
        """Position of the tip of the tool at the end, below the surface."""
        return self.sheet_um + self.site.beyond_exit_um if self.site.through else self.site.depth_um

    @property
    def worn_um(self) -> float:
        """Position that the tip would have without wear."""
        return self.tip_um + (self.site.wear_um if math.isfinite(self.site.wear_um) else 0.0)

    def true_outline(self) -> Array | None:
        """Return the true hole from mouth to mouth, shape (n, 2) of across and depth; None without a truth.

        Walls are straight between mouth and floor; the edge of the floor is round.
        """
        site = self.site
        gap_um, depth_um = site.truth.side_gap_um, self.sheet_um if site.through else site.truth.depth_um
        if not (math.isfinite(gap_um) and math.isfinite(depth_um)):
            return None
        low_um = self.radius_um + gap_um
        mouth_um = low_um + (site.truth.taper_um if math.isfinite(site.truth.taper_um) else 0.0)
        if site.through:
            half = np.array([[mouth_um, 0.0], [low_um, depth_um], [math.nan, math.nan]])
        else:
            corner_um = site.truth.corner_um if math.isfinite(site.truth.corner_um) else 0.0
            half = np.vstack([[mouth_um, 0.0], _rounded(low_um, depth_um, min(corner_um, low_um, depth_um))])
        return _mirrored(half)

    def tool_tip(self) -> Array:
        """Return the end of the tool from right to left, shape (n, 2) of across and depth.

        Its edge is as round as that of the true floor, and square if that is unknown.
        """
        corner_um = self.site.truth.corner_um
        corner_um = 0.0 if self.site.through or not math.isfinite(corner_um) else corner_um
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
        """Return what is known of the gaps, and from where, line by line."""
        site = self.site
        known = {
            "working gap": math.nan if site.through else site.working_gap_um,
            "side gap by the profile": self.side_gap_um,
            "truth: side gap": site.truth.side_gap_um,
        }
        lines = [f"{name} {um:.1f} µm" for name, um in known.items() if math.isfinite(um)]
        shape = {"taper": site.truth.taper_um, "corner": site.truth.corner_um}
        return [*lines, ", ".join(f"{name} {um:.1f} µm" for name, um in shape.items() if math.isfinite(um))]


def draw(run: RunFile) -> Figure:
    """Draw the last holes of the run: one 85 mm wide, up to three 180 mm. Raises NothingToDraw."""
    sections, count = _sections(run)
    alone = len(sections) == 1
    width_mm = style.COLUMN_MM if alone else style.PAGE_MM
    panel_mm = (width_mm - style.LEFT_MM - style.RIGHT_MM - GAP_MM * (len(sections) - 1)) / len(sections)
    height_mm = panel_mm * max(section.scaled()[1] for section in sections)
    figure, panels = style.panels(
        style.Block("", {"below the face (µm)": height_mm / style.PANEL_MM}, (1.0,) * len(sections)),
        width_mm=width_mm,
        gap_mm=GAP_MM,
    )
    style.grow(figure, below_mm=LINE_MM * max(len(section.words()) for section in sections))
    first = count - len(sections) + 1
    for place, (axes, section) in enumerate(zip(panels, sections, strict=True)):
        # The letter is part of the title: beside one so long there is no room for it.
        letter = "" if alone else f"({'abc'[place]}) "
        of_all = "" if count == 1 else f" ({first + place} of {count})"
        axes.set_title("", loc="left")
        _draw_section(axes, section, f"{letter}{section.site.name}{of_all}")
    style.shared_legend(figure, panels, ncols=2 if alone else 4)
    return figure


def _sections(run: RunFile) -> tuple[list[Section], int]:
    """Return the holes to draw, and how many there are."""
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
            "The width of the tool is not in this file, and the hole is as wide; run files of jobs with a profile "
            "have it (tool.diameter_um)."
        )
    gap_um, sheet_um = plain_number(values.get("work.side_gap_um")), run.number("/entry/sample/thickness")
    return [Section(site, diameter_um, gap_um, sheet_um) for site in sites[-MOST_HOLES:]], len(sites)


def _draw_section(axes: Axes, section: Section, title: str) -> None:
    left_um, right_um, bottom_um, top_um = section.limits_um()
    scale, _ = section.scaled()
    axes.set_xlim(left_um, right_um)
    axes.set_ylim(bottom_um, top_um)
    _draw_work(axes, section)
    _draw_tool(axes, section)
    outline = section.true_outline()
    if outline is not None:
        axes.plot(*outline.T, color=GREEN, linewidth=1.0, label="truth (simulated)", zorder=4.0)
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
        axes.fill_between([inner_um, outer_um], 0.0, below_um, color=LIGHT, linewidth=0.0)
        axes.plot([inner_um] * 2, [0.0, end_um], color=FAINT, linestyle=(0, (3.0, 1.5)), label=name)
        axes.plot([inner_um, outer_um], [0.0, 0.0], color=BLACK)
    if site.through:
        return
    across_um = [-wall_um, wall_um]
    axes.fill_between(across_um, end_um, below_um, color=LIGHT, linewidth=0.0)
    label, dash = _FLOORS.get(site.depth_basis or "", ("floor", "-"))
    axes.plot(across_um, [end_um] * 2, color=BLACK, linewidth=1.4, linestyle=dash, label=label, zorder=3.0)
    if math.isfinite(site.depth_u95_um):
        low_um, high_um = end_um - site.depth_u95_um, end_um + site.depth_u95_um
        axes.fill_between(across_um, low_um, high_um, color=BLUE, alpha=0.25, linewidth=0.0, zorder=2.5)


def _draw_tool(axes: Axes, section: Section) -> None:
    """Draw the tool with its tip at the last touch, the working gap and the wear."""
    site, tip, top_um = section.site, section.tool_tip(), axes.get_ylim()[1]
    across = [-section.radius_um, section.radius_um]
    axes.fill(
        [*across, *tip[:, 0]], [top_um, top_um, *tip[:, 1]], facecolor=GREY, alpha=0.45, linewidth=0.0,
        label="tool at the end" if site.through else "tool at the bottom",
    )  # fmt: skip
    if math.isfinite(site.working_gap_um) and not site.through:
        gap_um = section.tip_um - site.working_gap_um
        axes.plot(across, [gap_um] * 2, color=GREY, linestyle=(0, (1.0, 1.0)), label="tip while sparking")
    if section.worn_um > section.tip_um:
        axes.fill(
            [*tip[:, 0], *across], [*tip[:, 1], section.worn_um, section.worn_um], facecolor="none",
            edgecolor=VERMILION, hatch="/////", linewidth=0.6, linestyle=":", label="worn off the tool",
        )  # fmt: skip


def _draw_lengths(axes: Axes, section: Section, at_um: float) -> None:
    """Draw arrows of depth and wear beside the hole, with their numbers."""
    site = section.site
    if site.through:
        beyond = with_u95(site.beyond_exit_um, site.beyond_exit_u95_um, 1)
        words = BEYOND_EXIT.replace(" the", "\nthe")
        style.draw_length(axes, at_um, (section.end_um, section.tip_um), BLUE, f"{words}\n{beyond} µm")
    else:
        depth = marked(with_u95(site.depth_um, site.depth_u95_um, 1), site.depth_basis)
        style.draw_length(axes, at_um, (0.0, site.depth_um), BLUE, f"depth\n{depth} µm")
    if math.isfinite(site.wear_um):
        wear = marked(with_u95(site.wear_um, site.wear_u95_um, 1), site.wear_basis)
        style.draw_length(axes, at_um, (section.tip_um, section.worn_um), VERMILION, f"wear\n{wear} µm")


def _mirrored(half: Array) -> Array:
    """Return an outline with its mirror image on the left."""
    outline: Array = np.vstack([half, half[::-1] * [-1.0, 1.0]])
    return outline


def _rounded(across_um: float, depth_um: float, corner_um: float) -> Array:
    """Return a corner of that radius below a vertical wall, shape (ARC_POINTS, 2) of across and depth."""
    angle = np.linspace(0.0, 0.5 * math.pi, ARC_POINTS)
    arc: Array = np.column_stack(
        [across_um - corner_um * (1.0 - np.cos(angle)), depth_um - corner_um * (1.0 - np.sin(angle))]
    )
    return arc


def scale_of(height_over_width: float) -> float:
    """Return by how much depths are stretched, so that a section is neither a line nor a needle; often 1."""
    if FLATTEST <= height_over_width <= TALLEST:
        return 1.0
    middle = math.sqrt(FLATTEST * TALLEST)
    return min(SCALES, key=lambda scale: abs(math.log(scale * height_over_width / middle)))
