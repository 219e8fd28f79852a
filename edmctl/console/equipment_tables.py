"""Tables of `doctor` and `ports`: what is connected, who answers there, and what each check found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.console.layout import render_columns
from edmctl.console.style import PLAIN, Ink, Style

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.results.equipment import Check, PortRow

NOTHING = (
    "This computer lists no serial ports, the setup names none, and nobody serves a virtual one.\n"
    "Plug the controller in, or try the virtual one: `edmctl simulate serve --link edm`, then --port edm."
)
_INKS = {"warn": Ink.WARNING, "fail": Ink.ERROR}


def render_checks(checks: Sequence[Check], style: Style = PLAIN) -> str:
    """Render the checks under each other, names aligned."""
    width = max((len(check.name) for check in checks), default=0)
    lines = []
    for check in checks:
        status = f"{check.status:4}"
        ink = _INKS.get(str(check.status))
        painted = style.paint(status, ink) if ink else status
        lines.append(f"{painted}  {check.name:{width}}  {check.message}")
        if check.fix:
            lines.append(f"{'':{width + 8}}{style.paint('fix:', Ink.NOTE)} {check.fix}")
    return "\n".join(lines)


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
