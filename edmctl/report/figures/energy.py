"""Energy of the discharges, and the removed volume over the energy."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.pulse_statistics import SparkEnergies, cuts_with_pulses, spark_energies
from edmctl.report.removal import Removal, cumulated, in_this_run, kappa, removal
from edmctl.report.style import BLACK, BLUE, DASHED, GREY, VERMILION, NothingToDraw
from edmctl.wording import count, to_its_u95

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
    of = "" if energies.is_single else ", mean of a block"
    blocks = [
        style.Block(
            f"energy per discharge{of} (µJ)",
            {f"share of discharges\nper {energies.edges_uj[1]:.2g} µJ (%)": 1.0},
        )
    ]
    if len(found.time_s):
        volume = "volume removed by\nthis run" if is_resumed else "removed volume\n"
        label = f"{volume}{' ' if is_resumed else ''}(10$^{{-3}}$ mm³)"
        blocks.append(style.Block("energy of normal discharges and arcs so far (J)", {label: 1.25}))
    figure, axes = style.panels(*blocks)
    _draw_histogram(axes[0], energies)
    for below in axes[1:]:
        expected = float(run.profile_values()["work.removal_um3_per_uj"])
        _draw_volume(below, found, edges_s, energies.sums_uj, expected)
    style.shared_legend(figure, axes)
    return figure


def _draw_histogram(axes: Axes, found: SparkEnergies) -> None:
    total = found.normal.sum() + found.arc.sum()
    normal, arc = 100.0 * found.normal / total, 100.0 * found.arc / total
    name = "normal discharges" if found.is_single else "normal discharges and arcs"
    axes.stairs(normal, found.edges_uj, fill=True, color=style.NORMAL, label=name)
    if found.arc.any():
        axes.stairs(
            normal + arc, found.edges_uj, baseline=normal, fill=True, facecolor=style.ARC, edgecolor=BLACK,
            linewidth=0.0, hatch=style.PULSE_HATCHES["arc"], label="arcs",
        )  # fmt: skip
    middle_uj = 0.5 * (found.edges_uj[1:] + found.edges_uj[:-1])
    mean_uj = float(((found.normal + found.arc) * middle_uj).sum() / total)
    axes.axvline(mean_uj, color=BLACK, linestyle=DASHED, label=f"mean {mean_uj:.3g} µJ")
    axes.set_xlim(0.0, found.edges_uj[-1])
    style.note_above(axes, f"{count(int(total))} discharges")


def _of_hole_uj(found: Removal, edges_s: Array, sums_uj: Array) -> Array:
    """Energy spent on the hole of each row until then, shape (n,)."""
    total_uj = np.concatenate([[0.0], np.cumsum(sums_uj)])
    begun_uj = np.interp(found.began_s, edges_s, total_uj)[found.hole]
    spent_uj: Array = np.maximum(0.0, np.interp(found.time_s, edges_s, total_uj) - begun_uj)
    return spent_uj


def _draw_volume(axes: Axes, found: Removal, edges_s: Array, sums_uj: Array, expected: float) -> None:
    """Draw volume over energy; `expected` is the ratio of both in the profile, µm³/µJ."""
    until_uj = np.interp(found.time_s, edges_s, np.concatenate([[0.0], np.cumsum(sums_uj)]))
    volume_um3, u95_um3 = cumulated(found)
    # µm³/µJ times J is 10⁻³ mm³.
    energy_j = np.array([0.0, 1.04 * until_uj.max() / UJ_PER_J])
    axes.plot(
        energy_j, expected * energy_j, color=GREY, linewidth=1.0, linestyle=DASHED,
        label=f"profile: κ = {expected:.3g}",
    )  # fmt: skip
    fit = kappa(found, _of_hole_uj(found, edges_s, sums_uj))
    if fit is not None:
        label = f"κ = {to_its_u95(fit.value, fit.u95)} µm³/µJ"
        axes.plot(energy_j, fit.value * energy_j, color=VERMILION, linewidth=1.0, label=label)
        # The width of the hole is the profile's; its share of the uncertainty is unknown.
        points = "the last touched point" if fit.holes == 1 else f"{fit.holes} last touched points"
        style.note_above(axes, f"κ by {points}, ± of depth alone")
    for touched, name in ((True, "by touched depth"), (False, "by estimated depth")):
        rows = found.touched == touched
        if rows.any():
            volume, u95 = (values[rows] / UM3_PER_MM3 * 1e3 for values in (volume_um3, u95_um3))
            at = until_uj[rows] / UJ_PER_J
            style.draw_points(axes, at, volume, u95, BLUE, full=touched, bars=BLACK, size=3.6, label=name)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
