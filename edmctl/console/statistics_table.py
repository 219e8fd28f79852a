"""Tables of simulated runs: their statistics, and how far to trust what is measured."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.console.layout import narrowed, not_shown, render_columns, render_table
from edmctl.console.style import PLAIN, Style
from edmctl.wording import decimal, percent, plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.results.simulation import Case, Statistics

_TRUE_NAMES = {"depth_um": "true depth, µm", "wear_um": "true wear, µm"}
_NAMES = {
    "depth_um": "depth, µm",
    "wear_um": "tool wear, µm",
    "machining_time_s": "machining time, s",
    "time_s": "whole job, s",
    "depth_error_um": "depth error, µm",
    "wear_error_um": "wear error, µm",
}
FIRST_TO_GO = ("true wear, µm", "true depth, µm", "failed")
"""Columns of several cases that a narrow terminal does without, one after the other."""


def render_cases(cases: Sequence[Case], style: Style = PLAIN) -> str:
    """Render one case in full; of several, one line each."""
    return _render_case(cases[0], style) if len(cases) == 1 else _render_overview(cases, style)


def _render_case(case: Case, style: Style) -> str:
    header = [f"{case.label}, {plural(len(case.runs), 'run')}", "mean", "sd", "min", "max"]
    rows = [
        [names[key], *(decimal(value) for value in (s.mean, s.sd, s.minimum, s.maximum))]
        for names, statistics in (
            (_TRUE_NAMES, case.truth),
            (_NAMES, case.spreads),
            (_of_basis("by model"), case.by_model),
            (_of_basis("estimated"), case.estimated),
        )
        for key, s in statistics.items()
    ]
    lines = [render_columns(header, rows, style)]
    if case.coverage:
        shares = " and ".join(f"{percent(share, 0)} of the {name}s" for name, share in case.coverage.items())
        lines.append(f"The 95 % intervals held {shares}.")
    if case.failed:
        lines.append(f"{case.failed} of {plural(len(case.runs), 'run')} failed.")
    return "\n".join(lines)


def _of_basis(basis: str) -> dict[str, str]:
    """Return the names of quantities that were not touched with a sensor."""
    return {key: name.replace(",", f" {basis},") for key, name in _NAMES.items()}


def _render_overview(cases: Sequence[Case], style: Style) -> str:
    table = {"mean ± sd": [case.label for case in cases]}
    table |= {name: [_mean_sd(case.truth.get(key)) for case in cases] for key, name in _TRUE_NAMES.items()}
    for key in ("depth_error_um", "machining_time_s"):
        table[_NAMES[key]] = [_mean_sd(case.spreads.get(key)) for case in cases]
    table["failed"] = [f"{case.failed} of {len(case.runs)}" for case in cases]
    shown = narrowed(table, style.columns, FIRST_TO_GO)
    return "\n".join(filter(None, [render_table(shown, style), not_shown(table, shown)]))


def _mean_sd(found: Statistics | None) -> str:
    if found is None:
        return "–"
    return f"{decimal(found.mean)} ± {decimal(found.sd)}" if math.isfinite(found.sd) else decimal(found.mean)
