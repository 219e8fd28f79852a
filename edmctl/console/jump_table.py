"""Electrode jumps, one by one and in summary."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import decimal, duration, length, plural

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MOST_ROWS = 20
"""More jumps are in the JSON object and in the run file."""


class JumpView(Protocol):
    """One jump."""

    @property
    def number(self) -> int: ...
    @property
    def height_um(self) -> float: ...
    @property
    def height_model_um(self) -> float: ...
    @property
    def residual_um(self) -> float: ...
    @property
    def residual_model_um(self) -> float: ...
    @property
    def settling_s(self) -> float: ...


class JumpSummaryView(Protocol):
    """Mean and largest."""

    @property
    def height_mean_um(self) -> float: ...
    @property
    def height_max_um(self) -> float: ...
    @property
    def residual_mean_um(self) -> float: ...
    @property
    def residual_max_um(self) -> float: ...
    @property
    def model_error_mean_um(self) -> float: ...
    @property
    def model_error_max_um(self) -> float: ...
    @property
    def settling_mean_s(self) -> float: ...
    @property
    def settling_max_s(self) -> float: ...


class JumpSeriesView(Protocol):
    """A series."""

    @property
    def wanted_um(self) -> float: ...
    @property
    def start_um(self) -> float: ...
    @property
    def start_v(self) -> float: ...
    @property
    def jumps(self) -> Sequence[JumpView]: ...
    @property
    def summary(self) -> JumpSummaryView: ...


def render_jumps(series: JumpSeriesView, style: Style = PLAIN) -> str:
    """Render a line per jump, at most `MOST_ROWS`, and what all of them come to."""
    rows = [
        [
            str(jump.number),
            length(jump.height_um),
            length(jump.height_model_um),
            length(jump.residual_um),
            length(jump.residual_model_um),
            _ms(jump.settling_s),
        ]
        for jump in series.jumps[:MOST_ROWS]
    ]
    header = ["jump", "height", "by voltage", "residual", "by voltage", "settled after"]
    table = render_columns(header, rows, style, align=">")
    left = len(series.jumps) - MOST_ROWS
    more = [f"… and {plural(left, 'more jump')}"] if left > 0 else []
    s = series.summary
    lines = [
        f"From {length(series.start_um)} ({decimal(series.start_v)} V), {length(series.wanted_um)} wanted.",
        table,
        *more,
        f"Height {length(s.height_mean_um)} on average, {length(s.height_max_um)} at most; residual "
        f"{length(s.residual_mean_um)}, at most {length(s.residual_max_um)}; the model is off the residual by "
        f"{length(s.model_error_mean_um)}, at most {length(s.model_error_max_um)}; settled after "
        f"{_ms(s.settling_mean_s)}, at most {_ms(s.settling_max_s)}.",
    ]
    return "\n".join(lines)


def render_jump_plan(forecast: Mapping[str, float], style: Style = PLAIN) -> str:
    """Render what a series will be."""
    rows = [
        ["jumps", f"{forecast['count']:.0f}"],
        ["height", length(forecast["height_um"])],
        ["speed", f"{forecast['speed_um_s']:g} µm/s"],
        ["dwell", _ms(forecast["dwell_s"])],
        ["every", f"{forecast['period_s']:g} s"],
        ["from", length(forecast["from_um"])],
        ["time", duration(forecast["time_s"])],
    ]
    return render_columns(["jump-flush", "forecast"], rows, style)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"
