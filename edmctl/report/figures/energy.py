"""Energy of the discharges, and the removed volume over the energy that it took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.pulse_statistics import SparkEnergies, cuts_with_pulses, spark_energies
from edmctl.report.removal import Removal, cumulated, in_this_run, kappa, removal
from edmctl.report.style import (
    ARC,
    BLACK,
    BLUE,
    DASHED,
    GREY,
    NORMAL,
    PULSE_HATCHES,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    new_figure,
    shared_legend,
)
from edmctl.wording import count, to_its_u95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile


UM3_PER_MM3 = 1e9
UJ_PER_J = 1e6


def draw(run: RunFile) -> Figure:
    """Draw the histogram of energies, and the volume by measured depths over the energy of all discharges so far."""
    cuts = cuts_with_pulses(run)
    found = removal(run)
    edges_s = np.unique(np.concatenate([cuts[[0, -1], [0, 1]], found.began_s, found.time_s]))
    energies = spark_energies(run, edges_s)
    if energies is None:
        raise NothingToDraw("There was no discharge while cutting: every pulse was open or short.")
    is_resumed = bool(run.text("/entry/parent_run"))
    if is_resumed:
        found = in_this_run(found, _of_hole_uj(found, edges_s, energies.sums_uj))
    has_volume = len(found.time_s) > 0
    figure = new_figure(100.0 if has_volume else 58.0)
    panels = figure.subplots(1 + has_volume, 1, squeeze=False, height_ratios=[1.0, 1.25][: 1 + has_volume])
    _draw_histogram(panels[0, 0], energies)
    if has_volume:
        believed = float(run.profile_values()["work.removal_um3_per_uj"])
        _draw_volume(panels[1, 0], found, edges_s, energies.sums_uj, believed)
        if is_resumed:
            panels[1, 0].set_ylabel("volume removed by\nthis run (10$^{-3}$ mm³)")
        letter_panels(panels[:, 0])
        figure.align_ylabels()
    shared_legend(figure, panels[:, 0])
    return figure


def _draw_histogram(axes: Axes, found: SparkEnergies) -> None:
    total = found.normal.sum() + found.arc.sum()
    normal, arc = 100.0 * found.normal / total, 100.0 * found.arc / total
    name = "normal discharges" if found.is_single else "normal discharges and arcs"
    axes.stairs(normal, found.edges_uj, fill=True, color=NORMAL, label=name)
    if found.arc.any():
        axes.stairs(
            normal + arc,
            found.edges_uj,
            baseline=normal,
            fill=True,
            facecolor=ARC,
            edgecolor=BLACK,
            linewidth=0.0,
            hatch=PULSE_HATCHES["arc"],
            label="arcs",
        )
    middle_uj = 0.5 * (found.edges_uj[1:] + found.edges_uj[:-1])
    mean_uj = float(((found.normal + found.arc) * middle_uj).sum() / total)
    axes.axvline(mean_uj, color=BLACK, linewidth=0.8, linestyle=DASHED, label=f"mean {mean_uj:.3g} µJ")
    axes.set_xlim(0.0, found.edges_uj[-1])
    of = "" if found.is_single else ", mean of a block"
    axes.set_xlabel(f"energy per discharge{of} (µJ)")
    axes.set_ylabel(f"share of discharges\nper {found.edges_uj[1]:.2g} µJ (%)")
    axes.set_title(f"{count(int(total))} discharges", loc="right", pad=3.0)


def _of_hole_uj(found: Removal, edges_s: Array, sums_uj: Array) -> Array:
    """Energy spent on the hole of each row until then, shape (n,)."""
    total_uj = np.concatenate([[0.0], np.cumsum(sums_uj)])
    begun_uj = np.interp(found.began_s, edges_s, total_uj)[found.hole]
    spent_uj: Array = np.maximum(0.0, np.interp(found.time_s, edges_s, total_uj) - begun_uj)
    return spent_uj


def _draw_volume(axes: Axes, found: Removal, edges_s: Array, sums_uj: Array, expected: float) -> None:
    """Draw volume over energy; `expected` is what the profile believes of both, µm³/µJ."""
    until_uj = np.interp(found.time_s, edges_s, np.concatenate([[0.0], np.cumsum(sums_uj)]))
    volume_um3, u95_um3 = cumulated(found)
    fit = kappa(found, _of_hole_uj(found, edges_s, sums_uj))
    end_j = 1.04 * until_uj.max() / UJ_PER_J
    # µm³/µJ times J is 10⁻³ mm³.
    axes.plot(
        [0.0, end_j],
        [0.0, expected * end_j],
        color=GREY,
        linewidth=1.0,
        linestyle=DASHED,
        label=f"profile: κ = {expected:.3g}",
    )
    if fit is not None:
        axes.plot(
            [0.0, end_j],
            [0.0, fit.value * end_j],
            color=VERMILION,
            linewidth=1.0,
            label=f"κ = {to_its_u95(fit.value, fit.u95)} µm³/µJ",
        )
    for touched, name in ((True, "by touched depth"), (False, "by estimated depth")):
        rows = found.touched == touched
        if rows.any():
            volume, u95 = (values[rows] / UM3_PER_MM3 * 1e3 for values in (volume_um3, u95_um3))
            at = until_uj[rows] / UJ_PER_J
            draw_points(axes, at, volume, u95, BLUE, full=touched, bars=BLACK, size=3.6, label=name)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("energy of normal discharges and arcs so far (J)")
    axes.set_ylabel("removed volume\n(10$^{-3}$ mm³)")
    if fit is not None:
        # The width of the hole is the profile's: nobody measured its share of the uncertainty.
        points = "the last touched point" if fit.holes == 1 else f"{fit.holes} last touched points"
        axes.set_title(f"κ by {points}, ± of depth alone", loc="right", pad=3.0)
