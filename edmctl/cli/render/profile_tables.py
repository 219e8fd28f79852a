"""Profiles for people: the list of those shipped, values as TOML that explains itself, and forecasts of jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from edmctl.cli.render.terminal import PLAIN, Ink, Style, narrowed, not_shown, render_columns, render_table
from edmctl.results.result import Forecast, ProfileSummary
from edmctl.toml_text import toml_value
from edmctl.wording import count, decimal, duration, length, percent, plural, removal_rate

_COMMENT_COLUMN = 36
LEAST_BEYOND_UM = 0.1
FIRST_TO_GO = ("stroke µm", "tool wear µm", "10⁻³ mm³/min", "machining")
"""Columns of several forecasts that a narrow terminal does without, one after the other."""


def render_profiles(found: Sequence[ProfileSummary], style: Style = PLAIN) -> str:
    """Render a table of profiles: name, what it makes, how long that takes and what it wears off the tool."""
    table = {
        "profile": [one.profile for one in found],
        "makes": [one.refused or one.description for one in found],
        "tool → work": [one.materials or "–" for one in found],
        "takes": ["–" if one.time_s is None else duration(one.time_s) for one in found],
        "tool wear": ["–" if one.tool_wear_um is None else f"{one.tool_wear_um:.0f} µm" for one in found],
    }
    shown = narrowed(table, style.columns, ["tool → work", "tool wear"])
    return render_table(shown, style, left=["makes"], cut_first="makes")


def render_toml(
    tables: Mapping[str, Mapping[str, object] | Sequence[Mapping[str, object]]],
    stated: Mapping[str, Any],
    comments: Mapping[str, str],
    style: Style = PLAIN,
) -> str:
    """Return `tables` as TOML in which keys that are not in `stated` are commented out.

    A list of tables becomes an array of tables; an empty one is left out. `comments` has a text for `table.key`.
    """
    blocks = []
    for table, values in tables.items():
        written = stated.get(table)
        if isinstance(values, Mapping):
            blocks.append(_block(f"[{table}]", table, values, written, comments, style))
        else:
            pairs = zip(values, written or (), strict=True)
            blocks += [_block(f"[[{table}]]", table, *pair, comments, style) for pair in pairs]
    return "\n\n".join(blocks)


def _block(
    header: str,
    table: str,
    values: Mapping[str, object],
    written: Mapping[str, object] | None,
    comments: Mapping[str, str],
    style: Style,
) -> str:
    lines = [f"{'# ' if written is None else ''}{style.paint(header, Ink.STRONG)}"]
    stated = written or {}
    for key, value in {**values, **stated}.items():
        line = f"{'' if key in stated else '# '}{key} = {toml_value(value)}"
        comment = comments.get(f"{table}.{key}", "")
        if comment:
            line = line.ljust(_COMMENT_COLUMN) + style.paint(f" # {comment}", Ink.FAINT)
        lines.append(line)
    return "\n".join(lines)


def render_forecast(name: str, forecast: Forecast, style: Style = PLAIN) -> str:
    """Render the forecast of the job `name`."""
    cycle_ms = 1e3 * forecast.limit_cycle_period_s
    steps = f"{forecast.cuts} passes" if forecast.channel_um > 0.0 else plural(forecast.cuts, "cut")
    rows = [
        *_work(forecast),
        _stroke(forecast),
        ("machining", duration(forecast.machining_time_s), steps),
        ("measuring", duration(forecast.measuring_time_s), plural(forecast.stops, "stop")),
        ("whole job", duration(forecast.time_s)),
        ("pulses", count(forecast.pulses), f"{forecast.spark_energy_uj:.0f} µJ each at most"),
        ("removal rate", removal_rate(forecast.mrr_mm3_min)),
        ("jumping", percent(forecast.jump_share), "of the time"),
        ("servo swing", f"± {forecast.limit_cycle_um:.3f} µm", f"every {cycle_ms:.0f} ms"),
        ("loop delay", f"{1e3 * forecast.loop_delay_s:.1f} ms"),
    ]
    return render_columns([name, "forecast", ""], rows, style, align="<><")


def render_forecasts(named: Sequence[tuple[str, Forecast]], style: Style = PLAIN) -> str:
    """Render the forecasts of several jobs: all of a single one, otherwise a row for each."""
    if len(named) == 1:
        return render_forecast(*named[0], style)
    forecasts = [forecast for _, forecast in named]
    table = {
        "": [name for name, _ in named],
        "depth µm": [decimal(forecast.depth_um) for forecast in forecasts],
        "tool wear µm": [decimal(forecast.tool_wear_um) for forecast in forecasts],
        "stroke µm": [decimal(forecast.stroke_um) for forecast in forecasts],
        "machining": [duration(forecast.machining_time_s) for forecast in forecasts],
        "whole job": [duration(forecast.time_s) for forecast in forecasts],
        "10⁻³ mm³/min": [decimal(1e3 * forecast.mrr_mm3_min, 3) for forecast in forecasts],
    }
    shown = narrowed(table, style.columns, FIRST_TO_GO)
    return "\n".join(filter(None, [render_table(shown, style), not_shown(table, shown)]))


def _work(forecast: Forecast) -> list[Sequence[str]]:
    depth, wear = ("depth", length(forecast.depth_um)), ("tool wear", length(forecast.wear_um))
    feed = ("feed", length(forecast.feed_um))
    if forecast.channel_um > 0.0:
        channel = ("channel", length(forecast.channel_um), plural(forecast.layers, "layer"))
        return [channel, depth, (*wear, "over the whole channel"), feed]
    beyond_um = forecast.feed_um - forecast.depth_um - forecast.wear_um
    beyond = f", {length(beyond_um)} of it behind the sheet" if beyond_um > LEAST_BEYOND_UM else ""
    surface = f"Ra {forecast.ra_um:.2f} µm, Rz {forecast.rz_um:.2f} µm"
    rows: list[Sequence[str]] = [
        depth,
        wear,
        (*feed, f"{forecast.feed_rate_um_s:.3f} µm/s{beyond}"),
        ("roughness", surface, "by the laws of the process"),
    ]
    for regime in forecast.regimes:
        costs = (
            f"{duration(regime.machining_time_s)}, wear {length(regime.wear_um)}, Ra {regime.ra_um:.2f} µm"
        )
        rows.append((f"regime {regime.name}", f"to {length(regime.depth_um)}", costs))
    if forecast.holes == 1:
        return rows
    worn, holes = ("tool wear", length(forecast.tool_wear_um), "in all"), ("holes", count(forecast.holes))
    if forecast.depth_min_um < forecast.depth_um:
        depths = ("depth", f"{forecast.depth_min_um:.2f} to {length(forecast.depth_um)}")
        return [holes, depths, *[(*row[:2], "at most") for row in rows[1:]], worn]
    return [holes, *[(*row, "each") if len(row) == 2 else row for row in rows], worn]


def _stroke(forecast: Forecast) -> Sequence[str]:
    available = length(forecast.stroke_available_um)
    if forecast.holes > 1 and forecast.holes_in_reach < forecast.holes:
        return ("stroke", available, f"for the first {plural(forecast.holes_in_reach, 'hole')} only")
    return ("stroke", length(forecast.stroke_um), f"of {available}")
