"""What a job is expected to take."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import count, decimal, duration, length, percent, plural, removal_rate

if TYPE_CHECKING:
    from collections.abc import Sequence


LEAST_BEYOND_UM = 0.1


class ForecastView(Protocol):
    """Expected course of a job: of one hole, of several (`holes`), or of a channel (`channel_um` above 0)."""

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
    def depth_min_um(self) -> float: ...
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
    @property
    def holes(self) -> int: ...
    @property
    def holes_in_reach(self) -> int: ...
    @property
    def stops(self) -> int: ...
    @property
    def tool_wear_um(self) -> float: ...
    @property
    def channel_um(self) -> float: ...
    @property
    def layers(self) -> int: ...


def render_forecast(name: str, forecast: ForecastView, style: Style = PLAIN) -> str:
    """Render the forecast of the job `name`."""
    cycle_ms = 1e3 * forecast.limit_cycle_period_s
    rows = [
        *_work(forecast),
        _stroke(forecast),
        _row("machining", duration(forecast.machining_time_s), _steps(forecast)),
        _row("measuring", duration(forecast.measuring_time_s), plural(forecast.stops, "stop")),
        _row("whole job", duration(forecast.time_s)),
        _row("pulses", count(forecast.pulses), f"{forecast.spark_energy_uj:.0f} µJ each at most"),
        _row("removal rate", removal_rate(forecast.mrr_mm3_min)),
        _row("jumping", percent(forecast.jump_share), "of the time"),
        _row("servo swing", f"± {forecast.limit_cycle_um:.3f} µm", f"every {cycle_ms:.0f} ms"),
        _row("loop delay", f"{1e3 * forecast.loop_delay_s:.1f} ms"),
    ]
    return render_columns([name, "forecast", ""], rows, style, align="<><")


def render_forecasts(named: Sequence[tuple[str, ForecastView]], style: Style = PLAIN) -> str:
    """Render the forecasts of several jobs: all of a single one, otherwise a row for each."""
    if len(named) == 1:
        return render_forecast(*named[0], style)
    header = ("", "depth µm", "tool wear µm", "stroke µm", "machining", "whole job", "10⁻³ mm³/min")
    rows = [
        (
            name,
            decimal(forecast.depth_um),
            decimal(forecast.tool_wear_um),
            decimal(forecast.stroke_um),
            duration(forecast.machining_time_s),
            duration(forecast.time_s),
            decimal(1e3 * forecast.mrr_mm3_min, 3),
        )
        for name, forecast in named
    ]
    return render_columns(header, rows, style)


def _work(forecast: ForecastView) -> list[Sequence[str]]:
    """What is made, and what it costs the tool."""
    depth, wear = length(forecast.depth_um), length(forecast.wear_um)
    feed = length(forecast.feed_um)
    beyond_um = forecast.feed_um - forecast.depth_um - forecast.wear_um
    beyond = f", {length(beyond_um)} of it behind the sheet" if beyond_um > LEAST_BEYOND_UM else ""
    if forecast.channel_um > 0.0:
        return [
            _row("channel", length(forecast.channel_um), plural(forecast.layers, "layer")),
            _row("depth", depth),
            _row("tool wear", wear, "over the whole channel"),
            _row("feed", feed),
        ]
    rows = [
        _row("depth", depth),
        _row("tool wear", wear),
        _row("feed", feed, f"{forecast.feed_rate_um_s:.3f} µm/s{beyond}"),
    ]
    if forecast.holes == 1:
        return rows
    worn = _row("tool wear", length(forecast.tool_wear_um), "in all")
    holes = _row("holes", count(forecast.holes))
    if forecast.depth_min_um < forecast.depth_um:
        depths = f"{forecast.depth_min_um:.2f} to {depth}"
        return [holes, _row("depth", depths), *[(*row[:2], "at most") for row in rows[1:]], worn]
    return [holes, *[(*row, "each") if len(row) == 2 else row for row in rows], worn]


def _stroke(forecast: ForecastView) -> Sequence[str]:
    """The stroke that is needed, or how many holes it lasts for."""
    available = length(forecast.stroke_available_um)
    if forecast.holes > 1 and forecast.holes_in_reach < forecast.holes:
        return _row("stroke", available, f"for the first {plural(forecast.holes_in_reach, 'hole')} only")
    return _row("stroke", length(forecast.stroke_um), f"of {available}")


def _steps(forecast: ForecastView) -> str:
    return f"{forecast.cuts} passes" if forecast.channel_um > 0.0 else plural(forecast.cuts, "cut")


def _row(name: str, value: str, remark: str = "") -> Sequence[str]:
    return (name, value, remark) if remark else (name, value)
