"""The readings Z1, Z2 and Z3 of each hole, with the depth, the tool wear and the feed that they give.

Like Fig. 9(b) of Muralidhara et al. 2009: Z1 touches the surface before, Z2 the bottom, Z3 the surface after.
So feed = Z2 − Z1, depth = Z2 − Z3 and wear = Z3 − Z1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis, basis_of, marked
from edmctl.record.results import has_sensor
from edmctl.report.numbers import numbers_of
from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    GREEN,
    GREY,
    PAGE_MM,
    VERMILION,
    NothingToDraw,
    new_figure,
    shared_legend,
)
from edmctl.results.run_file import RecordedSite
from edmctl.wording import with_u95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile

HEIGHT_MM = 72.0
COLUMN_SITES = 3
"""As many sites fit into one column."""
NUMBERED_SITES = 12
"""With more sites there is no room for numbers below them."""
NAMED_SITES = 30
STEP, PITCH = 1.0, 4.4
"""Width of one reading, and distance from site to site, on the horizontal axis."""
MEASURED, CONTACT = "measured", "by contact, estimated displacement"
UNTOUCHED, ESTIMATED = "without a touch", "estimated from voltage"
QUANTITIES = (("depth", BLUE), ("wear", VERMILION), ("feed", GREEN))


@dataclass(frozen=True, slots=True)
class _Readings:
    """Z1, Z2 and Z3 of a site, µm, which of them were touched, and what the voltage alone says of them."""

    site: RecordedSite
    z_um: tuple[float, float, float]
    touched: tuple[bool, bool, bool]
    model_um: tuple[float, float, float]


def draw(run: RunFile) -> Figure:
    """Draw the figure: 85 mm wide up to three sites, else 180 mm. Raises NothingToDraw without a measured site."""
    sensor = has_sensor(run)
    sites = [
        site
        for site in (_readings(run, one) for one in numbers_of(run).sites)
        if np.isfinite(site.z_um).all()
    ]
    if not sites:
        raise NothingToDraw(
            "No site of this run was measured, so there are no readings Z1, Z2 and Z3; a job that reaches its "
            "first measuring stop has them."
        )
    figure = new_figure(HEIGHT_MM, PAGE_MM if len(sites) > COLUMN_SITES else COLUMN_MM)
    axes = figure.subplots()
    for number, site in enumerate(sites):
        _draw_site(axes, site, number * PITCH, MEASURED if sensor else CONTACT, alone=len(sites) == 1)
        # Without a sensor the touches are estimates from the voltage themselves.
        if sensor:
            _draw_estimate(axes, site.model_um, number * PITCH)
    if len(sites) > 1:
        _draw_columns(axes, [site.site for site in sites])
    else:
        bottom = "tip at\nthe end" if sites[0].site.through else "bottom"
        axes.set_xticks([0.5, 1.5, 2.5], ["Z1\nsurface before", f"Z2\n{bottom}", "Z3\nsurface after"])
        axes.set_title(sites[0].site.name, loc="left", pad=2.0)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    room = 1.25 if len(sites) == 1 else 0.6  # for the words beside the arrows
    axes.set_xlim(-0.15 if len(sites) == 1 else -0.6, (len(sites) - 1) * PITCH + 3.0 * STEP + room)
    axes.set_ylabel("tool displacement (µm)")
    axes.margins(y=0.12)
    shared_legend(figure, [axes], ncols=3)
    return figure


def _readings(run: RunFile, site: RecordedSite) -> _Readings:
    """Put together what is known of a site.

    In an array Z1 may follow from the holes before, without a touch. The model has Z1 as touched, and from there Z2
    and Z3 by its own wear and depth; it is NaN where one of them is unknown.
    """
    touches = run.table("/entry/touches")
    own = touches[(touches["kind"] == b"Z1") & (touches["accepted"] == 1)]
    own = [row for row in own if row["site"].decode(errors="ignore") == site.name]
    z1_um = float(own[-1]["z_model"]) if own else math.nan
    z3_um = z1_um + site.wear_model_um
    z2_um = z3_um + site.depth_model_um
    return _Readings(
        site=site,
        z_um=(site.z1_um, site.z2_um, site.z3_um),
        touched=(bool(own), site.depth_basis in (Basis.TOUCHED, Basis.MODEL), _pad_was_touched(site)),
        model_um=(z1_um, z2_um, z3_um) if math.isfinite(z2_um) else (math.nan, math.nan, math.nan),
    )


def _pad_was_touched(site: RecordedSite) -> bool:
    """Whether Z3 is a touch: that of a hole through the sheet is one, and so is that of a touched depth."""
    return site.through or site.depth_basis != Basis.ESTIMATED


def _draw_site(axes: Axes, readings: _Readings, left: float, words: str, *, alone: bool) -> None:
    site, z_um = readings.site, readings.z_um
    edges = left + STEP * np.arange(4.0)
    for number, (value_um, touched) in enumerate(zip(z_um, readings.touched, strict=True)):
        label = words if touched else UNTOUCHED
        axes.plot(
            edges[number : number + 2],
            [value_um, value_um],
            color=BLACK,
            linewidth=1.2,
            linestyle="-" if touched else (0, (1.0, 0.8)),
            label="_" if label in axes.get_legend_handles_labels()[1] else label,
        )
    for edge, ends in zip(edges[1:], pairwise(z_um), strict=False):
        axes.plot([edge, edge], ends, color=BLACK, linewidth=0.5)
    low, high = left + 0.18 * STEP, left + 3.12 * STEP
    axes.plot([left + 3.0 * STEP, high], [z_um[2], z_um[2]], color=GREY, linewidth=0.5, linestyle=":")
    # Z1 goes on to where depth and wear are measured from it.
    axes.plot([left + STEP, high], [z_um[0], z_um[0]], color=GREY, linewidth=0.5, linestyle=":")
    axes.plot([left, left + STEP], [z_um[1], z_um[1]], color=GREY, linewidth=0.5, linestyle=":")
    axes.plot([left + 2.0 * STEP, high], [z_um[1], z_um[1]], color=GREY, linewidth=0.5, linestyle=":")
    for name, colour, at, ends in (
        ("feed", GREEN, low, (z_um[0], z_um[1])),
        ("depth", BLUE, high, (z_um[2], z_um[1])),
        ("wear", VERMILION, high, (z_um[0], z_um[2])),
    ):
        if name == "depth" and site.through:
            continue
        _arrow(axes, at, ends, colour)
        if alone:
            number_um = _number(site, name)
            if name == "feed":  # between its arrow and the step there is little room
                number_um = number_um.replace(" ±", "\n±")
            axes.annotate(
                f"{name}\n{number_um} µm",
                (at, 0.5 * (ends[0] + ends[1])),
                xytext=(3.0, 0.0),
                textcoords="offset points",
                color=colour,
                va="center",
            )


def _draw_estimate(axes: Axes, model_um: Sequence[float], left: float) -> None:
    if not np.isfinite(model_um).all():
        return
    named = ESTIMATED in axes.get_legend_handles_labels()[1]
    for number, value_um in enumerate(model_um):
        ends = left + STEP * np.array([number + 0.1, number + 0.9])
        label = "_" if named or number else ESTIMATED
        axes.plot(
            ends, [value_um, value_um], color=GREY, linewidth=1.0, linestyle=(0, (2.5, 1.2)), label=label
        )


def _arrow(axes: Axes, at: float, ends: tuple[float, float], colour: str) -> None:
    axes.annotate(
        "",
        xy=(at, ends[1]),
        xytext=(at, ends[0]),
        arrowprops={
            "arrowstyle": "<|-|>,head_length=0.28,head_width=0.14",
            "color": colour,
            "linewidth": 0.8,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        },
    )


def _number(site: RecordedSite, name: str) -> str:
    value_um: float = getattr(site, f"{name}_um")
    u95_um: float = getattr(site, f"{name}_u95_um")
    return marked(with_u95(value_um, u95_um, 1), basis_of(name, site.depth_basis, site.wear_basis))


def _draw_columns(axes: Axes, sites: Sequence[RecordedSite]) -> None:
    """Name the sites below their columns, and give their numbers there."""
    middles = np.arange(len(sites)) * PITCH + 1.5 * STEP
    names = [site.name for site in sites]
    if len(sites) > NUMBERED_SITES:
        every = -(-len(sites) // NAMED_SITES)
        axes.set_xticks(middles[::every], names[::every], rotation=90)
        return
    axes.set_xticks(middles, names)
    axes.tick_params(axis="x", labelsize=6.0)
    for row, (name, colour) in enumerate(QUANTITIES):
        down = -15.0 - 9.0 * row
        axes.annotate(
            f"{name} (µm)", (0.0, 0.0),
            xytext=(-4.0, down), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="center", color=colour, fontsize=6.0,
        )  # fmt: skip
        for middle, site in zip(middles, sites, strict=True):
            axes.annotate(
                _number(site, name), (middle, 0.0), xytext=(0.0, down),
                xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="center", va="center", color=colour, fontsize=6.0,
            )  # fmt: skip
