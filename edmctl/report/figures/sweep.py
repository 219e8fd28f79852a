"""Cases of simulated runs side by side: removal rate, wear, time and error of depth, with their scatter."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from edmctl.report.style import BLUE, GREY, NothingToDraw, new_figure
from edmctl.results.simulation import Case, Statistics

QUANTITIES = (
    ("mrr_mm3_min", "removal rate, 10⁻³ mm³/min", 1e3),
    ("wear_ratio_lin", "wear per depth", 1.0),
    ("machining_time_s", "machining time, s", 1.0),
    ("arc_share", "arcs, %", 100.0),
)
MOST_LABELS = 12


def draw_cases(cases: Sequence[Case]) -> Figure:
    """Draw means over the runs of each case, bars of a standard deviation. Raises NothingToDraw for no cases."""
    if not cases:
        raise NothingToDraw("no run is finished")
    places, axis, labels = _places(cases)
    figure = new_figure(95.0, 120.0)
    axes = figure.subplots(2, 2, sharex=True)
    for panel, (name, title, scale) in zip(axes.flat, QUANTITIES, strict=True):
        found = [(x, s) for x, case in zip(places, cases, strict=True) if (s := case.spreads.get(name))]
        if not found:
            panel.text(0.5, 0.5, "nothing measured", ha="center", color=GREY, transform=panel.transAxes)
        panel.errorbar(
            [x for x, _ in found],
            [scale * s.mean for _, s in found],
            yerr=[scale * _sd(s) for _, s in found],
            fmt="o" if labels else "o-",
            color=BLUE,
            markersize=3,
            capsize=2,
        )
        panel.set_ylabel(title)
        if labels:
            panel.set_xticks(places, labels, rotation=90)
        panel.margins(x=0.08)
    for panel in axes[1]:
        panel.set_xlabel(axis)
    figure.suptitle(_bars(cases), fontsize="small", color=GREY)
    return figure


def _bars(cases: Sequence[Case]) -> str:
    """What points and bars are."""
    counts = sorted({len(case.runs) for case in cases})
    runs = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    if counts[-1] == 1:
        return "one run a case: no bars"
    return f"means of {runs} runs a case; bars ± one standard deviation of a run"


def _sd(found: Statistics) -> float:
    return found.sd if math.isfinite(found.sd) else 0.0


def _places(cases: Sequence[Case]) -> tuple[list[float], str, list[str]]:
    """Return places on the axis of x: values of the one number that differs, else the order of the cases."""
    settings = [dict(part.partition("=")[::2] for part in case.overrides) for case in cases]
    keys = sorted({key for one in settings for key in one if len({other.get(key) for other in settings}) > 1})
    if len(keys) == 1 and len(cases) > 1:
        try:
            return [float(one[keys[0]]) for one in settings], keys[0], []
        except (KeyError, ValueError):
            pass
    words = [", ".join(one.get(key, "") for key in keys) for one in settings]
    names = [word or case.label for word, case in zip(words, cases, strict=True)]
    shown = names if len(names) <= MOST_LABELS else [""] * len(names)
    return [float(n) for n in range(len(cases))], ", ".join(keys) or "case", shown
