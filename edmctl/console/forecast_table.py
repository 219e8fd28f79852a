"""What a job is expected to take."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.console.text import count, duration, length, percent, plural

if TYPE_CHECKING:
    from collections.abc import Sequence


class ForecastView(Protocol):
    """Expected course of a job."""

    @property
    def machining_time_s(self) -> float: ...
    @property
    def measuring_time_s(self) -> float: ...
    @property
    def time_s(self) -> float: ...
    @property
    def cuts(self) -> int: ...
    @property
    def feed_rate_um_s(self) -> float: ...
    @property
    def feed_um(self) -> float: ...
    @property
    def depth_um(self) -> float: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def stroke_um(self) -> float: ...
    @property
    def stroke_available_um(self) -> float: ...
    @property
    def loop_delay_s(self) -> float: ...
    @property
    def limit_cycle_um(self) -> float: ...
    @property
    def limit_cycle_period_s(self) -> float: ...
    @property
    def spark_energy_uj(self) -> float: ...
    @property
    def mrr_mm3_min(self) -> float: ...
    @property
    def jump_share(self) -> float: ...
    @property
    def pulses(self) -> int: ...


def render_forecast(name: str, forecast: ForecastView, style: Style = PLAIN) -> str:
    """Render the forecast of the job `name`."""
    cycle_ms = 1e3 * forecast.limit_cycle_period_s
    rows = [
        _row("depth", length(forecast.depth_um)),
        _row("tool wear", length(forecast.wear_um)),
        _row("feed", length(forecast.feed_um), f"{forecast.feed_rate_um_s:.3f} µm/s"),
        _row("stroke", length(forecast.stroke_um), f"of {length(forecast.stroke_available_um)}"),
        _row("machining", duration(forecast.machining_time_s), plural(forecast.cuts, "cut")),
        _row("measuring", duration(forecast.measuring_time_s)),
        _row("whole job", duration(forecast.time_s)),
        _row("pulses", count(forecast.pulses), f"{forecast.spark_energy_uj:.0f} µJ each at most"),
        _row("removal rate", f"{1e3 * forecast.mrr_mm3_min:.3f} × 10⁻³ mm³/min"),
        _row("jumping", percent(forecast.jump_share), "of the time"),
        _row("servo swing", f"± {forecast.limit_cycle_um:.3f} µm", f"every {cycle_ms:.0f} ms"),
        _row("loop delay", f"{1e3 * forecast.loop_delay_s:.1f} ms"),
    ]
    return render_columns([name, "forecast", ""], rows, style, align="<><")


def _row(name: str, value: str, remark: str = "") -> Sequence[str]:
    return (name, value, remark) if remark else (name, value)
