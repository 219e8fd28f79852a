"""The serial ports of this computer, and which process holds one."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

from edmctl.dataclasses import dataclass

_PTY = re.compile(r"/dev/(pts/|ttys\d|pty)")
"""Of Linux, macOS and BSD."""
ST_LINK_IDS = [
    f"0483:{product}" for product in ["374b", "374d", "374e", "374f", "3752", "3753", "3754", "3757"]
]
"""ST-LINK/V2-1 and V3 with a serial port. Every board of ST has one, so `auto` asks only those of a setup."""


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A port as the computer lists it; `usb_id` is "VID:PID" in lower-case hex, "" where it is not on USB."""

    device: str
    description: str = ""
    usb_id: str = ""
    usb_serial: str = ""


DEVICE, SOCKET = "", "socket"
"""Schemes of a port that is named by its path, and of a socket."""


def scheme_of(name: str) -> str:
    """Return the scheme of a port's URL in lower case; `DEVICE` for a path."""
    return name.partition("://")[0].lower() if "://" in name else DEVICE


def st_links() -> list[PortInfo]:
    """Return those of the listed ports that are of an ST-LINK."""
    return [port for port in listed_ports() if port.usb_id in ST_LINK_IDS]


def listed_ports() -> list[PortInfo]:
    """Return the serial ports that this computer lists, by name."""
    from serial.tools.list_ports import comports

    return sorted(
        (
            PortInfo(
                device=port.device,
                description="" if port.description in (None, "n/a") else port.description,
                usb_id="" if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
                usb_serial=port.serial_number or "",
            )
            for port in comports()
        ),
        key=lambda port: port.device,
    )


def probable_ports(usb_ids: Iterable[str], candidates: Iterable[str]) -> list[PortInfo]:
    """Return the ports that may be asked: those of known USB ids, and those that the setup names."""
    known = {usb_id.lower() for usb_id in usb_ids}
    listed = listed_ports()
    ports = [port for port in listed if port.usb_id in known]
    for name in candidates:
        # A port under two names would be asked twice at once, and be held by ourselves.
        if not any(same_port(name, port.device) for port in ports):
            same = [port for port in listed if same_port(name, port.device)]
            ports.append(same[0] if same else PortInfo(name))
    return ports


def same_port(name: str, other: str) -> bool:
    """Whether two names, one of which may be a symbolic link, mean one port."""
    if name == other:
        return True
    return "://" not in name + other and os.path.realpath(name) == os.path.realpath(other)


def is_adapter(name: str) -> bool:
    """Whether a name, which may be a symbolic link, is that of a serial port: no pty, no socket, no `sim:`."""
    return "://" not in name and not name.startswith("sim:") and not _PTY.match(os.path.realpath(name))
