"""Who answers at the ports of this computer, and the line to the one that is meant."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import monotonic

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError
from edmctl.link import ports as known
from edmctl.link.messages import HelloReply
from edmctl.link.opening import BOARD_BAUD, open_line, waited_for
from edmctl.link.serial_line import SerialLine

HELLO_S = 1.5
"""A board that resets when its port is opened needs about this long to come up."""


@dataclass(frozen=True, slots=True)
class ProbedPort:
    """What a port said to HELLO: the controller's reply, or why there is none."""

    port: known.PortInfo
    hello: HelloReply | None
    error: str = ""


def probe(
    ports: Sequence[known.PortInfo], baud: int, hello_s: float = HELLO_S, secret: bytes = b""
) -> list[ProbedPort]:
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
            raise failures.serial_number_missing()
        on_usb = [port.device for port in known.listed_ports() if port.usb_serial == wanted]
        if len(on_usb) == 1:
            return on_usb[0]
        return _by_controller(wanted, probe(known.probable_ports(usb_ids, candidates), baud, hello_s, secret))
    answers = probe(known.probable_ports(usb_ids, candidates), baud, hello_s, secret)
    there = [answer for answer in answers if answer.hello]
    if len(there) == 1:
        return there[0].port.device
    if there:
        named = "; ".join(f"--port serial:{a.hello.serial} ({a.port.device})" for a in there if a.hello)
        raise failures.several_controllers(count=len(there), how="", named=named)
    raise failures.no_controller_answers(answers=_seen(answers), remedy=_where(answers))


_WHERE = "Name the port with --port, or add it to link.candidates or its USB id to link.usb_ids in the setup."


def _where(answers: Sequence[ProbedPort]) -> str:
    """What to do where nobody answers; the ST-LINK of a NUCLEO is asked by no default."""
    asked = {answer.port.device for answer in answers}
    board = next((port for port in known.st_links() if port.device not in asked), None)
    if board is None:
        return _WHERE
    lines = f'usb_ids = ["{board.usb_id}"] and baud = {BOARD_BAUD} below [link]'
    return f"{_WHERE} {board.device} is an ST-LINK: for a NUCLEO with the firmware say {lines}."


def _by_controller(wanted: str, answers: Sequence[ProbedPort]) -> str:
    devices = [a.port.device for a in answers if a.hello and a.hello.serial == wanted]
    if len(devices) == 1:
        return devices[0]
    if devices:
        named = "; ".join(f"--port {device}" for device in devices)
        raise failures.several_controllers(count=len(devices), how=f" as {wanted}", named=named)
    raise failures.controller_not_found(wanted=wanted, answers=_seen(answers), remedy=_where(answers))


def _seen(answers: Sequence[ProbedPort]) -> str:
    if not answers:
        names = ", ".join(port.device for port in known.listed_ports()) or "no serial ports"
        return f"No port has a known USB id, and the setup names none; this computer lists {names}."
    return "Asked: " + "; ".join(
        f"{a.port.device}: {f'controller {a.hello.serial}' if a.hello else a.error}" for a in answers
    )


def _ask(port: known.PortInfo, baud: int, hello_s: float, secret: bytes) -> ProbedPort:
    from edmctl.link.session import Session

    try:
        session = Session(open_line(port.device, baud, secret=secret))
        try:
            return ProbedPort(port, session.open(hello_s))
        finally:
            session.close()
    except EdmError as error:
        return ProbedPort(port, None, error.message)


def open_selector(
    selector: str,
    usb_ids: Sequence[str],
    candidates: Sequence[str],
    baud: int,
    hello_s: float,
    wait_s: float = 0.0,
    say: Callable[[str], None] | None = None,
    secret: bytes = b"",
) -> SerialLine:
    """Open what a selector means: `auto` and `serial:ID` are looked for, and waited for like any other port.

    Raises what `open_line` and `find` raise.
    """
    if selector != "auto" and not selector.startswith("serial:"):
        return open_line(selector, baud, wait_s, say, secret)
    end_s = monotonic() + wait_s
    url = waited_for(lambda: find(selector, usb_ids, candidates, baud, hello_s, secret), wait_s, say)
    return open_line(url, baud, max(0.0, end_s - monotonic()), say, secret)
