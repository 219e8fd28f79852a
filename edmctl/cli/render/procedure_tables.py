"""Tables of commands that do one thing: an approach, electrode jumps, a measurement of wear, `doctor`, `ports`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from edmctl.cli.render.result_table import beliefs_in_words
from edmctl.cli.render.terminal import PLAIN, USUAL_COLUMNS, Ink, Style, render_columns, wrapped
from edmctl.labels import Basis, basis_of, heading, marked, meanings
from edmctl.quantity import half_width
from edmctl.results.measurements import Check, DriftResult, JumpSeries, PortRow, SurfaceFound, WearResult
from edmctl.wording import coordinates, decimal, duration, escaped, length, percent, plural, with_u95

MOST_ROWS = 20
"""More jumps are in the JSON object and in the run file."""


def render_surface(found: SurfaceFound, style: Style = PLAIN) -> str:
    """Render where the gap or the surface was found."""
    rows = [
        ["displacement", length(found.displacement_um), length(found.model_um)],
        ["actuator", f"{decimal(found.actuator_v)} V"],
        ["way from home", duration(found.travel_s)],
    ]
    if found.touches:
        rows.append(["touches", f"{found.touches} within {length(found.sd_um)} rms"])
    place = f"{found.kind} at {coordinates(found.x_um, found.y_um)}"
    return render_columns([place, "measured", "from voltage"], rows, style)


_PLAN_ROWS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "expected_um": ("expected", length),
    "max_travel_um": ("gives up after", length),
    "readings": ("readings", ", ".join),
    "touches": ("touches each", str),
    "interval_s": ("a touch every", duration),
    "hold_um": ("hold beside the work, at", length),
    "hold_s": ("hold for", duration),
    "count": ("jumps", str),
    "height_um": ("height", length),
    "speed_um_s": ("speed", lambda um_s: f"{um_s:g} µm/s"),
    "dwell_s": ("dwell", lambda seconds: _ms(seconds)),
    "period_s": ("every", lambda seconds: f"{seconds:g} s"),
    "from_um": ("from", length),
    "time_s": ("time", duration),
}


def render_procedure_plan(title: str, forecast: Mapping[str, Any], style: Style = PLAIN) -> str:
    """Render the forecast of a procedure, in the order of the rows above."""
    rows = [[label, text(forecast[key])] for key, (label, text) in _PLAN_ROWS.items() if key in forecast]
    return render_columns([title, "forecast"], rows, style)


def render_jumps(series: JumpSeries, style: Style = PLAIN) -> str:
    """Render a line per jump, at most `MOST_ROWS`, and what all of them come to."""
    rows = [
        [
            str(jump.number),
            *map(length, (jump.height_um, jump.height_model_um, jump.residual_um, jump.residual_model_um)),
            _ms(jump.settling_s),
        ]
        for jump in series.jumps[:MOST_ROWS]
    ]
    header = ["jump", "height", "by voltage", "residual", "by voltage", "settled after"]
    left = len(series.jumps) - MOST_ROWS
    s = series.summary
    lines = [
        f"From {length(series.start_um)} ({decimal(series.start_v)} V), {length(series.wanted_um)} wanted.",
        render_columns(header, rows, style, align=">"),
        *([f"… and {plural(left, 'more jump')}"] if left > 0 else []),
        f"Height {length(s.height_mean_um)} on average, {length(s.height_max_um)} at most; residual "
        f"{length(s.residual_mean_um)}, at most {length(s.residual_max_um)}; the model is off the residual by "
        f"{length(s.model_error_mean_um)}, at most {length(s.model_error_max_um)}; settled after "
        f"{_ms(s.settling_mean_s)}, at most {_ms(s.settling_max_s)}.",
    ]
    return "\n".join(lines)


def render_wear(
    name: str,
    found: WearResult,
    ledger_um: float,
    total_um: float,
    truth: Mapping[str, float] | None,
    style: Style = PLAIN,
) -> str:
    """Render what was found at the hole `name`.

    ledger_um : sum of the wears of the tool's jobs since its reference; total_um : what it has lost in all
    """
    has_depth = found.depth_basis is not None
    bases = (found.depth_basis, found.wear_basis)
    head = heading(bases)
    # Lengths by the model alone would be in the table twice.
    has_sensor = found.wear_basis != Basis.MODEL
    header = [name, head, *(["from voltage"] if has_sensor else []), *(["truth"] if truth else [])]
    rows = []
    for key in ("depth", "wear", "feed") if has_depth else ("wear",):
        value, u95, model, model_u95 = (
            getattr(found, f"{key}_{part}um") for part in ("", "u95_", "model_", "model_u95_")
        )
        row = ["tool wear" if key == "wear" else key, marked(length(value, u95), basis_of(key, *bases), head)]
        row += [length(model, model_u95)] if has_sensor else []
        rows.append([*row, length(truth[f"{key}_um"])] if truth else row)
    heights = {"Z1 reference": found.z1_um, "Z2 bottom": found.z2_um, "Z3 pad": found.z3_um}
    heights["drift of Z3"] = found.drift_um
    rows += [[key, length(um)] for key, um in heights.items() if has_depth or key != "Z2 bottom"]
    columns = ["standard uncertainty", "depth", "tool wear", "feed"]
    parts = [[one.source, *map(length, (one.depth_um, one.wear_um, one.feed_um))] for one in found.budget]
    if not has_depth:
        columns, *parts = ([source, wear_um] for source, _, wear_um, _ in (columns, *parts))
    words = [
        f"At least {found.touches} touches of every Z. The tool's jobs account for {length(ledger_um)} of wear; it "
        f"has lost {length(total_um)} in all.",
        f"The drift file gives a drift of {length(found.drift_correction_um)} since the reference; it is taken "
        "off wear and feed."
        if found.drift_correction_um
        else "Drift since the reference is not corrected; it is in the intervals.",
    ]
    if not has_depth:
        words.insert(0, "No depth: the tool's last job left no measured bottom. Name a hole with --site.")
    table = "\n".join([render_columns(header, rows, style), *meanings(bases, head)])
    return "\n\n".join([table, render_columns(columns, parts, style), *words])


def render_reference(
    tool: str, z1_um: float, sd_um: float, touches: int, model_um: float, style: Style = PLAIN
) -> str:
    """Render the reference of a tool: its mean Z1, and the scatter of the touches."""
    rows = [
        ["Z1 reference", length(z1_um), length(model_um)],
        ["touches", f"{touches} within {length(sd_um)} rms"],
    ]
    return render_columns([tool, "measured", "from voltage"], rows, style)


def render_drift(
    found: DriftResult,
    truth: Mapping[str, float] | None,
    path: str,
    use: str,
    *,
    replaced: bool,
    style: Style = PLAIN,
) -> str:
    """Render what rests and touches tell of drift, where that is kept, and who uses it (no full stop)."""
    header = ["measure-drift", "measured"]
    rows = [
        ["drift of the rests", _nm_s(found.rest_um_per_s, found.rest_u_um_per_s)],
        ["drift of the touches", _nm_s(found.touch_um_per_s, found.touch_u_um_per_s)],
        ["touches less rests", _nm_s(found.apart_um_per_s, found.apart_u_um_per_s)],
        ["share that a touch sees", with_u95(found.share, half_width(found.share_u))],
        ["creep after the hold", length(found.creep_um, half_width(found.creep_u_um))],
        [
            "scatter about that",
            f"{length(found.rest_rms_um)} at rest, {length(found.touch_rms_um)} at the pad",
        ],
    ]
    if truth is not None:
        header.append("truth")
        sensor_um_s, machine_um_s = truth["sensor_um_per_s"], truth["machine_um_per_s"]
        values = (sensor_um_s, sensor_um_s + machine_um_s, machine_um_s)
        for row, value in zip(rows, values, strict=False):
            row.append(_nm_s(value))
    used = percent(found.share_used, 0)
    share = f"Jobs take {used} of the drift of their rests off wear, Z2 and Z3."
    if math.isnan(found.share):
        share = f"The rests have not drifted by more than their random walk: no share can be told. {share}"
    elif abs(found.share - found.share_used) > half_width(found.share_u):
        share += (
            " Touches drift besides: a drift between tool and work does not show at rest, and widens the interval "
            "of the wear."
        )
    older = ", in the place of an older one" if replaced else ""
    kept = f"{found.touches} touches, {plural(found.rests, 'rest')}; in {path}{older}: {use}."
    beliefs = beliefs_in_words(found.beliefs)
    words = [line for text in (share, beliefs) if text for line in wrapped(text, USUAL_COLUMNS)]
    return "\n".join([render_columns(header, rows, style), *words, kept])


def _nm_s(um_per_s: float, u_um_per_s: float = math.nan) -> str:
    return f"{with_u95(1e3 * um_per_s, half_width(1e3 * u_um_per_s))} nm/s"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"


NOTHING = (
    "This computer lists no serial ports, the setup names none, and nobody serves a virtual one.\n"
    "Plug the controller in, or try the virtual one: `edmctl simulate serve --link edm`, then --port edm."
)


_INKS = {"warn": Ink.WARNING, "fail": Ink.ERROR}


def render_checks(checks: Sequence[Check], style: Style = PLAIN) -> str:
    """Render the checks under each other, each with its remedy."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2, 0, 0))
    for check in checks:
        text = Text(escaped(check.message), overflow="fold")
        if check.fix:
            text.append("\nfix:", style=Ink.NOTE).append(f" {escaped(check.fix)}")
        status = Text(str(check.status), style=_INKS.get(str(check.status), ""))
        table.add_row(status, Text(check.name, no_wrap=True), text)
    return style.render(table)


def render_ports(ports: Sequence[PortRow], style: Style = PLAIN) -> str:
    """Render a table, and a line for each port that was asked."""
    if not ports:
        return NOTHING
    rows = [
        (
            port.device,
            port.description or "–",
            port.usb_id or "–",
            port.usb_serial or "–",
            port.held_by or "–",
            "named" if port.in_setup else "–",
        )
        for port in ports
    ]
    header = ("port", "description", "USB id", "serial number", "held by", "setup")
    lines = [render_columns(header, rows, style, "<")]
    answers = [f"{port.device}: {_answer(port, style)}" for port in ports if port.controller or port.error]
    return "\n".join([*lines, "", *answers] if answers else lines)


def _answer(port: PortRow, style: Style) -> str:
    found = port.controller
    if found is None:
        return f"{style.paint('no', Ink.WARNING)}, {port.error}"
    kind = "virtual controller" if found.simulated else "controller"
    answer = (
        f"{kind} {found.serial}, firmware {found.firmware}, protocol {found.protocol}, in state {found.state}"
    )
    if found.fault:
        fault = f"fault {found.fault} {found.fault_name}".rstrip()
        answer += f", {style.paint(fault, Ink.ERROR)} latched"
    return answer
