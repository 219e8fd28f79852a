"""Tables of simulated runs: how far they spread, and how far to trust what is measured."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import decimal, percent, plural

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class SpreadView(Protocol):
    """Mean, standard deviation and range of one quantity."""

    @property
    def mean(self) -> float: ...
    @property
    def sd(self) -> float: ...
    @property
    def minimum(self) -> float: ...
    @property
    def maximum(self) -> float: ...


class CaseView(Protocol):
    """Many runs of one set of values; keys carry their unit. `truth` is what the plant knows.

    `spreads` are of what was touched, `by_model` of what was touched without a sensor, `estimated` of what was not.
    """

    @property
    def label(self) -> str: ...
    @property
    def runs(self) -> Sequence[object]: ...
    @property
    def failed(self) -> int: ...
    @property
    def spreads(self) -> Mapping[str, SpreadView]: ...
    @property
    def by_model(self) -> Mapping[str, SpreadView]: ...
    @property
    def estimated(self) -> Mapping[str, SpreadView]: ...
    @property
    def truth(self) -> Mapping[str, SpreadView]: ...
    @property
    def coverage(self) -> Mapping[str, float]: ...


_TRUE_NAMES = {"depth_um": "true depth, µm", "wear_um": "true wear, µm"}
_NAMES = {
    "depth_um": "depth, µm",
    "wear_um": "tool wear, µm",
    "machining_time_s": "machining time, s",
    "time_s": "whole job, s",
    "depth_error_um": "depth error, µm",
    "wear_error_um": "wear error, µm",
}


def render_cases(cases: Sequence[CaseView], style: Style = PLAIN) -> str:
    """Render one case in full; of several, one line each."""
    return _render_case(cases[0], style) if len(cases) == 1 else _render_overview(cases, style)


def _render_case(case: CaseView, style: Style) -> str:
    header = [f"{case.label}, {plural(len(case.runs), 'run')}", "mean", "sd", "min", "max"]
    rows = [
        [names[key], *(decimal(value) for value in (s.mean, s.sd, s.minimum, s.maximum))]
        for names, spreads in (
            (_TRUE_NAMES, case.truth),
            (_NAMES, case.spreads),
            (_of_basis("by model"), case.by_model),
            (_of_basis("estimated"), case.estimated),
        )
        for key, s in spreads.items()
    ]
    lines = [render_columns(header, rows, style)]
    if case.coverage:
        shares = " and ".join(f"{percent(share, 0)} of the {name}s" for name, share in case.coverage.items())
        lines.append(f"The 95 % intervals held {shares}.")
    if case.failed:
        lines.append(f"{case.failed} of {plural(len(case.runs), 'run')} failed.")
    return "\n".join(lines)


def _of_basis(basis: str) -> dict[str, str]:
    """The names of quantities that were not touched with a sensor."""
    return {key: name.replace(",", f" {basis},") for key, name in _NAMES.items()}


def _render_overview(cases: Sequence[CaseView], style: Style) -> str:
    keys = ("depth_error_um", "machining_time_s")
    header = ["mean ± sd", *_TRUE_NAMES.values(), *(_NAMES[key] for key in keys), "failed"]
    rows = [
        [
            case.label,
            *(_mean_sd(case.truth, key) for key in _TRUE_NAMES),
            *(_mean_sd(case.spreads, key) for key in keys),
            f"{case.failed} of {len(case.runs)}",
        ]
        for case in cases
    ]
    return render_columns(header, rows, style)


def _mean_sd(spreads: Mapping[str, SpreadView], key: str) -> str:
    spread = spreads.get(key)
    if spread is None:
        return "–"
    return (
        f"{decimal(spread.mean)} ± {decimal(spread.sd)}" if math.isfinite(spread.sd) else decimal(spread.mean)
    )
