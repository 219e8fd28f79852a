"""The readings Z1, Z2 and Z3 of each hole, with the depth, the tool wear and the feed that follow from them.

Like Fig. 9(b) of Muralidhara et al. 2009: Z1 touches the surface before, Z2 the bottom, Z3 the surface after.
So feed = Z2 − Z1, depth = Z2 − Z3 and wear = Z3 − Z1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, basis_of, marked
from edmctl.record.reader import RunFile
from edmctl.record.run_index import has_sensor
from edmctl.report import style
from edmctl.report.numbers import numbers_of
from edmctl.report.style import BLACK, BLUE, COLUMN_MM, GREEN, GREY, PAGE_MM, VERMILION, NothingToDraw
from edmctl.results.run_file import RecordedSite
from edmctl.wording import with_u95

COLUMN_SITES = 3
"""As many sites fit into one column."""
NUMBERED_SITES = 12
"""With more sites there is no room for numbers below them."""
NAMED_SITES = 30
STEP, PITCH = 1.0, 4.4
"""Width of one reading, and distance from site to site, on the horizontal axis."""
MEASURED, CONTACT = "measured", "by contact, estimated displacement"
UNTOUCHED, ESTIMATED = "without a touch", "estimated from voltage"
COLOURS = {"depth": BLUE, "wear": VERMILION, "feed": GREEN}


@dataclass(frozen=True, slots=True)
class _Readings:
    """Z1, Z2 and Z3 of a site, µm, which of them were touched, and their estimates from the voltage alone.

    In an array Z1 may follow from the holes before, without a touch. The estimate starts at Z1 as touched; Z2 and Z3
    follow by its own wear and depth, and are NaN if one of them is unknown.
    """

    site: RecordedSite
    z_um: tuple[float, float, float]
    touched: tuple[bool, bool, bool]
    model_um: tuple[float, float, float]

    @classmethod
    def of(cls, site: RecordedSite, run: RunFile) -> _Readings:
        """Collect what is known of a site."""
        rows = [
            row
            for row in run.table("/entry/touches")
            if row["kind"] == b"Z1" and row["accepted"] and row["site"].decode(errors="ignore") == site.name
        ]
        z1_um = float(rows[-1]["z_model"]) if rows else math.nan
        z3_um = z1_um + site.wear_model_um
        z2_um = z3_um + site.depth_model_um
        bottom = site.depth_basis in (Basis.TOUCHED, Basis.MODEL)
        # Z3 of a hole through the sheet is a touch, and so is that of a touched depth.
        after = site.through or site.depth_basis != Basis.ESTIMATED
        return cls(
            site, (site.z1_um, site.z2_um, site.z3_um), (bool(rows), bottom, after), (z1_um, z2_um, z3_um)
        )


def draw(run: RunFile) -> Figure:
    """Draw the figure: 85 mm wide up to three sites, else 180 mm. Raises NothingToDraw without a measured site."""
    sensor = has_sensor(run)
    all_readings = [_Readings.of(site, run) for site in numbers_of(run).sites]
    readings = [one for one in all_readings if np.isfinite(one.z_um).all()]
    if not readings:
        raise NothingToDraw(
            "No site of this run was measured, so there are no readings Z1, Z2 and Z3; a job that reaches its "
            "first measuring stop has them."
        )
    alone = len(readings) == 1
    figure, (axes,) = style.panels(
        style.Block("", {"tool displacement (µm)": 1.9}),
        width_mm=PAGE_MM if len(readings) > COLUMN_SITES else COLUMN_MM,
    )
    for number, one in enumerate(readings):
        _draw_site(axes, one, number * PITCH, MEASURED if sensor else CONTACT, alone=alone)
        # Without a sensor the touches are estimates from the voltage themselves.
        if sensor and np.isfinite(one.model_um).all():
            for step, value_um in enumerate(one.model_um):
                ends = number * PITCH + STEP * np.array([step + 0.1, step + 0.9])
                axes.plot(
                    ends,
                    [value_um] * 2,
                    color=GREY,
                    linewidth=1.0,
                    linestyle=(0, (2.5, 1.2)),
                    label=ESTIMATED,
                )
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    room = 1.35 if alone else 0.6  # for the words beside the arrows
    axes.set_xlim(-0.15 if alone else -0.6, (len(readings) - 1) * PITCH + 3.0 * STEP + room)
    axes.margins(y=0.12)
    if alone:
        bottom = "bottom"
        if readings[0].site.through:
            bottom = "tip at\nthe end"
            style.grow(figure, below_mm=2.5)
        axes.set_xticks([0.5, 1.5, 2.5], ["Z1\nsurface before", f"Z2\n{bottom}", "Z3\nsurface after"])
        axes.set_title(readings[0].site.name, loc="left", pad=2.0)
    else:
        _draw_columns(figure, axes, [one.site for one in readings])
    style.shared_legend(figure, [axes], ncols=3)
    return figure


def _draw_site(axes: Axes, readings: _Readings, left: float, words: str, *, alone: bool) -> None:
    site, z_um = readings.site, readings.z_um
    edges = left + STEP * np.arange(4.0)
    for number, (value_um, touched) in enumerate(zip(z_um, readings.touched, strict=True)):
        axes.plot(
            edges[number : number + 2], [value_um] * 2, color=BLACK, linewidth=1.2,
            linestyle="-" if touched else (0, (1.0, 0.8)), label=words if touched else UNTOUCHED,
        )  # fmt: skip
    for edge, ends in zip(edges[1:], pairwise(z_um), strict=False):
        axes.plot([edge, edge], ends, color=BLACK, linewidth=0.5)
    low, high = left + 0.18 * STEP, left + 3.12 * STEP
    # Each reading continues to the arrows that are measured from it.
    for value_um, begin, end in (
        (z_um[2], edges[3], high),
        (z_um[0], edges[1], high),
        (z_um[1], left, edges[1]),
        (z_um[1], edges[2], high),
    ):
        axes.plot([begin, end], [value_um] * 2, color=GREY, linewidth=0.5, linestyle=":")
    lengths = {
        "feed": (low, z_um[0], z_um[1]),
        "depth": (high, z_um[2], z_um[1]),
        "wear": (high, z_um[0], z_um[2]),
    }
    for name, (at, begin_um, end_um) in lengths.items():
        if name == "depth" and site.through:
            continue
        number_um = _number(site, name)
        if name == "feed":  # between its arrow and the step there is little room
            number_um = number_um.replace(" ±", "\n±")
        text = f"{name}\n{number_um} µm" if alone else ""
        style.draw_length(axes, at, (begin_um, end_um), COLOURS[name], text)


def _number(site: RecordedSite, name: str) -> str:
    text = with_u95(getattr(site, f"{name}_um"), getattr(site, f"{name}_u95_um"), 1)
    return marked(text, basis_of(name, site.depth_basis, site.wear_basis))


def _draw_columns(figure: Figure, axes: Axes, sites: Sequence[RecordedSite]) -> None:
    """Write the names of the sites below their columns, and their numbers."""
    middles = np.arange(len(sites)) * PITCH + 1.5 * STEP
    names = [site.name for site in sites]
    if len(sites) > NUMBERED_SITES:
        every = -(-len(sites) // NAMED_SITES)
        axes.set_xticks(middles[::every], names[::every], rotation=90)
        style.grow(figure, below_mm=1.3 * max(map(len, names)) - 4.0)
        return
    axes.set_xticks(middles, names)
    axes.tick_params(axis="x", labelsize=6.0)
    style.grow(figure, below_mm=5.5)
    for row, (name, colour) in enumerate(COLOURS.items()):
        down = -15.0 - 9.0 * row
        words = [(f"{name} (µm)", 0.0, "axes fraction", -4.0, "right")]
        words += [
            (_number(site, name), middle, "data", 0.0, "center")
            for middle, site in zip(middles, sites, strict=True)
        ]
        for text, at, of, aside, side in words:
            axes.annotate(
                text, (at, 0.0), xytext=(aside, down), xycoords=(of, "axes fraction"),
                textcoords="offset points", ha=side, va="center", color=colour, fontsize=6.0,
            )  # fmt: skip
