"""The ports of this computer, and below them who answered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Ink, Style
from edmctl.console.tables import render_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

NOTHING = (
    "This computer lists no serial ports, the setup names none, and nobody serves a virtual one.\n"
    "Plug the controller in, or try the virtual one: `edmctl simulate serve --link edm`, then --port edm."
)


class ControllerView(Protocol):
    """A controller that answered."""

    @property
    def serial(self) -> str: ...
    @property
    def firmware(self) -> str: ...
    @property
    def protocol(self) -> str: ...
    @property
    def state(self) -> str: ...
    @property
    def fault(self) -> int: ...
    @property
    def fault_name(self) -> str: ...
    @property
    def simulated(self) -> bool: ...


class PortView(Protocol):
    """A port, and what it said if it was asked."""

    @property
    def device(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def usb_id(self) -> str: ...
    @property
    def usb_serial(self) -> str: ...
    @property
    def held_by(self) -> str: ...
    @property
    def in_setup(self) -> bool: ...
    @property
    def controller(self) -> ControllerView | None: ...
    @property
    def error(self) -> str | None: ...


def render_ports(ports: Sequence[PortView], style: Style = PLAIN) -> str:
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


def _answer(port: PortView, style: Style) -> str:
    found = port.controller
    if found is None:
        return f"{style.paint('no', Ink.WARNING)}, {port.error}"
    kind = "virtual controller" if found.simulated else "controller"
    told = (
        f"{kind} {found.serial}, firmware {found.firmware}, protocol {found.protocol}, in state {found.state}"
    )
    if found.fault:
        fault = f"fault {found.fault} {found.fault_name}".rstrip()
        told += f", {style.paint(fault, Ink.ERROR)} latched"
    return told
