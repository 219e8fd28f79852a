"""The ports of this computer, and who answers there."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, LinkLost

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from edmctl.link.messages import HelloReply

_PTY = re.compile(r"/dev/(pts/|ttys\d|pty)")
"""Of Linux, macOS and BSD."""
HELLO_S = 1.5
"""A board that resets when its port is opened needs about this long to come up."""


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A port as the computer lists it; `usb_id` is "VID:PID" in lower-case hex, "" where it is not on USB."""

    device: str
    description: str = ""
    usb_id: str = ""
    usb_serial: str = ""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a port said to HELLO: the controller's reply, or why there is none."""

    port: PortInfo
    hello: HelloReply | None
    error: str = ""


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


def probe(
    ports: Sequence[PortInfo], baud: int, hello_s: float = HELLO_S, secret: bytes = b""
) -> list[Answer]:
    """Say hello at each port, all at the same time; `secret` for sockets that ask for one."""
    from concurrent.futures import ThreadPoolExecutor

    if not ports:
        return []
    with ThreadPoolExecutor(len(ports)) as pool:
        return list(pool.map(lambda port: _ask(port, baud, hello_s, secret), ports))


def find(
    selector: str,
    usb_ids: Iterable[str],
    candidates: Iterable[str],
    baud: int,
    hello_s: float,
    secret: bytes = b"",
) -> str:
    """Return the device that `auto` or `serial:ID` means.

    Raises LinkLost E4001 where none is found, E4007 where `auto` finds several.
    """
    if selector.startswith("serial:"):
        wanted = selector.removeprefix("serial:")
        # A port that tells no serial number must not match an empty one.
        if not wanted:
            raise LinkLost(
                "serial: names no serial number.",
                hint="Say serial:ID; `edmctl ports --probe` lists them.",
                code="E4002",
            )
        on_usb = [port.device for port in listed_ports() if port.usb_serial == wanted]
        if len(on_usb) == 1:
            return on_usb[0]
        return _by_controller(wanted, probe(probable_ports(usb_ids, candidates), baud, hello_s, secret))
    answers = probe(probable_ports(usb_ids, candidates), baud, hello_s, secret)
    there = [answer for answer in answers if answer.hello]
    if len(there) == 1:
        return there[0].port.device
    if there:
        named = "; ".join(f"--port serial:{a.hello.serial} ({a.port.device})" for a in there if a.hello)
        raise LinkLost(f"{len(there)} controllers answer.", hint=f"Say which: {named}.", code="E4007")
    raise LinkLost(f"No controller answers. {_seen(answers)}", hint=_WHERE, code="E4001")


_WHERE = "Name the port with --port, or add it to link.candidates or its USB id to link.usb_ids in the setup."


def _by_controller(wanted: str, answers: Sequence[Answer]) -> str:
    devices = [a.port.device for a in answers if a.hello and a.hello.serial == wanted]
    if len(devices) == 1:
        return devices[0]
    if devices:
        named = "; ".join(f"--port {device}" for device in devices)
        raise LinkLost(
            f"{len(devices)} controllers say that they are {wanted}.",
            hint=f"Say which: {named}.",
            code="E4007",
        )
    raise LinkLost(f"No controller {wanted} answers. {_seen(answers)}", hint=_WHERE, code="E4001")


def _seen(answers: Sequence[Answer]) -> str:
    if not answers:
        names = ", ".join(port.device for port in listed_ports()) or "no serial ports"
        return f"No port has a known USB id, and the setup names none; this computer lists {names}."
    return "Asked: " + "; ".join(
        f"{a.port.device}: {f'controller {a.hello.serial}' if a.hello else a.error}" for a in answers
    )


def _ask(port: PortInfo, baud: int, hello_s: float, secret: bytes) -> Answer:
    from edmctl.link.opening import open_line
    from edmctl.link.session import Session

    try:
        session = Session(open_line(port.device, baud, secret=secret))
        try:
            return Answer(port, session.open(hello_s))
        finally:
            session.close()
    except EdmError as error:
        return Answer(port, None, error.message)
