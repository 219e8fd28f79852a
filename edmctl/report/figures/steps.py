"""The readings Z1, Z2 and Z3 of each hole, with the depth, the tool wear and the feed that they give.

Like Fig. 9(b) of Muralidhara et al. 2009: Z1 touches the surface before, Z2 the bottom, Z3 the surface after.
So feed = Z2 − Z1, depth = Z2 − Z3 and wear = Z3 − Z1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    GREEN,
    GREY,
    PAGE_MM,
    VERMILLION,
    NothingToDraw,
    legend_above,
    new_figure,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

HEIGHT_MM = 72.0
COLUMN_SITES = 3
"""As many sites fit into one column."""
NUMBERED_SITES = 12
"""With more sites there is no room for numbers below them."""
NAMED_SITES = 30
STEP, PITCH = 1.0, 4.4
"""Width of one reading, and distance from site to site, on the horizontal axis."""
ESTIMATED = "estimated from voltage"
QUANTITIES = (("depth", BLUE), ("wear", VERMILLION), ("feed", GREEN))


def draw(run: RunFile) -> Figure:
    """Draw the figure: 85 mm wide up to three sites, else 180 mm. Raises NothingToDraw without a measured site."""
    results = run.table("/entry/results")
    known = np.isfinite(results["z1"]) & np.isfinite(results["z2"]) & np.isfinite(results["z3"])
    sites = results[known]
    if not len(sites):
        raise NothingToDraw(
            "No site of this run was measured, so there are no readings Z1, Z2 and Z3; a job that reaches its "
            "first measuring stop has them."
        )
    wide = len(sites) > COLUMN_SITES
    figure = new_figure(HEIGHT_MM, PAGE_MM if wide else COLUMN_MM)
    axes = figure.subplots()
    for number, site in enumerate(sites):
        _draw_site(axes, site, number * PITCH, alone=len(sites) == 1)
        _draw_estimate(axes, _model_um(run, site), number * PITCH)
    if len(sites) > 1:
        _draw_columns(axes, sites)
    else:
        axes.set_xticks([0.5, 1.5, 2.5], ["Z1\nsurface before", "Z2\nbottom", "Z3\nsurface after"])
        axes.set_title(sites[0]["site"].decode(), loc="left", pad=2.0)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    room = 1.25 if len(sites) == 1 else 0.6  # for the words beside the arrows
    axes.set_xlim(-0.15 if len(sites) == 1 else -0.6, (len(sites) - 1) * PITCH + 3.0 * STEP + room)
    axes.set_ylabel("tool displacement (µm)")
    axes.margins(y=0.12)
    legend_above(axes)
    return figure


def _model_um(run: RunFile, site: np.void) -> tuple[float, float, float]:
    """Return Z1, Z2 and Z3 by the estimated displacement: Z1 as touched, and from there by its wear and depth.

    NaN where one of them is unknown: in an array Z1 may follow from the holes before, without a touch.
    """
    touches = run.table("/entry/touches")
    own = touches[(touches["kind"] == b"Z1") & (touches["site"] == site["site"]) & (touches["accepted"] == 1)]
    z1_um = float(own["z_model"][-1]) if len(own) else float("nan")
    z3_um = z1_um + float(site["wear_model"])
    z2_um = z3_um + float(site["depth_model"])
    return (z1_um, z2_um, z3_um) if np.isfinite(z2_um) else (float("nan"),) * 3


def _draw_site(axes: Axes, site: np.void, left: float, *, alone: bool) -> None:
    z_um = [float(site[name]) for name in ("z1", "z2", "z3")]
    edges = left + STEP * np.array([0.0, 1.0, 1.0, 2.0, 2.0, 3.0])
    first = left == 0.0
    axes.plot(edges, np.repeat(z_um, 2), color=BLACK, linewidth=1.2, label="measured" if first else "_")
    low, high = left + 0.18 * STEP, left + 3.12 * STEP
    axes.plot([left + 3.0 * STEP, high], [z_um[2], z_um[2]], color=GREY, linewidth=0.5, linestyle=":")
    # Z1 goes on to where depth and wear are measured from it.
    axes.plot([left + STEP, high], [z_um[0], z_um[0]], color=GREY, linewidth=0.5, linestyle=":")
    axes.plot([left, left + STEP], [z_um[1], z_um[1]], color=GREY, linewidth=0.5, linestyle=":")
    axes.plot([left + 2.0 * STEP, high], [z_um[1], z_um[1]], color=GREY, linewidth=0.5, linestyle=":")
    for name, colour, at, ends in (
        ("feed", GREEN, low, (z_um[0], z_um[1])),
        ("depth", BLUE, high, (z_um[2], z_um[1])),
        ("wear", VERMILLION, high, (z_um[0], z_um[2])),
    ):
        _arrow(axes, at, ends, colour)
        if alone:
            axes.annotate(
                _words(site, name),
                (at, 0.5 * (ends[0] + ends[1])),
                xytext=(3.0, 0.0),
                textcoords="offset points",
                color=colour,
                va="center",
                fontsize=6.5,
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


def _words(site: np.void, name: str) -> str:
    value_um = float(site[name])
    u95_um = float(site[f"{name}_u95"]) if name != "feed" else float("nan")
    bounds = f" ± {u95_um:.1f}" if np.isfinite(u95_um) else ""
    return f"{name}\n{value_um:.1f}{bounds} µm"


def _draw_columns(axes: Axes, sites: NDArray[np.void]) -> None:
    """Name the sites below their columns, and give their numbers there."""
    middles = np.arange(len(sites)) * PITCH + 1.5 * STEP
    names = [site["site"].decode() for site in sites]
    if len(sites) > NUMBERED_SITES:
        every = -(-len(sites) // NAMED_SITES)
        axes.set_xticks(middles[::every], names[::every], rotation=90)
        return
    axes.set_xticks(middles, names)
    axes.tick_params(axis="x", labelsize=6.0)
    for row, (name, colour) in enumerate(QUANTITIES):
        down = -15.0 - 9.0 * row
        axes.annotate(
            f"{name} (µm)", (0.0, 0.0), xytext=(-4.0, down), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="center", color=colour, fontsize=6.0,
        )  # fmt: skip
        for middle, site in zip(middles, sites, strict=True):
            u95_um = float(site[f"{name}_u95"]) if name != "feed" else float("nan")
            bounds = f" ± {u95_um:.1f}" if np.isfinite(u95_um) else ""
            axes.annotate(
                f"{float(site[name]):.1f}{bounds}", (middle, 0.0), xytext=(0.0, down),
                xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="center", va="center", color=colour, fontsize=6.0,
            )  # fmt: skip
