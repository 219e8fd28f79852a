"""From a port's name to an open line, or to an error that says what to do."""

from __future__ import annotations

import errno
import re
import stat
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from time import monotonic, sleep
from typing import TypeVar

from edmctl import failures
from edmctl.errors import LinkLost, installing
from edmctl.files import lock_holder
from edmctl.link.gate import pass_gate
from edmctl.link.ports import DEVICE, SOCKET, listed_ports, scheme_of
from edmctl.link.serial_line import SCHEMES, SerialLine, open_port, reason_of

DEFAULT_BAUD = 500_000
BOARD_BAUD = 921_600
"""Of the firmware for a NUCLEO."""
_LOOK_AGAIN_S = 0.1
_MAY_PASS = ("E4001", "E4006")
_BUSY = (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK)
_INVALID = (TypeError, ValueError, LookupError, re.error)
_ABSENT = (errno.ENOENT, errno.ENXIO, errno.ENODEV)

T = TypeVar("T")


def open_line(
    url: str,
    baud: int = DEFAULT_BAUD,
    wait_s: float = 0.0,
    say: Callable[[str], None] | None = None,
    secret: bytes = b"",
) -> SerialLine:
    """Open a serial device or a pyserial URL for this program alone.

    url : device path, COM port, or URL such as socket://HOST:PORT
    wait_s : a port that is held or not there yet is tried again for so long, after a word to `say`
    secret : answers the challenge of a socket that asks for one

    Raises LinkLost: E4001 if the port is absent, E4006 if it is held, E4002 if it is not a port, E4004 without
    permission, E4023 without the secret that a socket asks for.
    """
    _check(url)
    return waited_for(lambda: _opened(url, baud, secret), wait_s, say)


def waited_for(attempt: Callable[[], T], wait_s: float, say: Callable[[str], None] | None) -> T:
    """Return the result of `attempt`, which is repeated for `wait_s` while the port is absent or held."""
    end_s = monotonic() + wait_s
    while True:
        try:
            return attempt()
        except LinkLost as error:
            if error.code not in _MAY_PASS or monotonic() >= end_s:
                raise
            if say is not None:
                say(f"{error.message} Waiting up to {wait_s:g} s.")
                say = None
        sleep(min(_LOOK_AGAIN_S, max(0.0, end_s - monotonic())))


def _opened(url: str, baud: int, secret: bytes) -> SerialLine:
    with ExitStack() as held:
        try:
            port = open_port(url, baud)
            held.callback(port.close)
            if scheme_of(url) == SOCKET:
                pass_gate(url, port, secret)
            line = SerialLine(url, port)
        except LinkLost:
            raise
        except Exception as failure:
            raise _explain(url, failure) from None
        held.pop_all()
    return line


def _check(url: str) -> None:
    """Refuse paths of things that are no ports before anything is written to them."""
    if scheme_of(url) != DEVICE:
        return
    with suppress(OSError, ValueError):
        mode = Path(url).stat().st_mode
        if not stat.S_ISCHR(mode):
            kinds = {stat.S_IFDIR: "a folder", stat.S_IFREG: "a plain file"}
            kind = kinds.get(stat.S_IFMT(mode), "no serial port")
            raise failures.port_is_another_thing(url=url, kind=kind, known_ports=known_ports())


def _explain(url: str, failure: Exception) -> LinkLost:
    causes = _causes(failure)
    number = next((one for cause in causes if (one := _number(cause)) is not None), None)
    device = url.partition("://")[2].partition("?")[0] or url
    other = next((cause for cause in causes if getattr(cause, "filename", None) not in (None, device)), None)
    if isinstance(other, OSError):
        return failures.port_option_unusable(filename=other.filename, url=url, reason=other.strerror)
    if number in _BUSY:
        return failures.port_held(name=url, owner=lock_holder(Path(device)) or "another program")
    if number in _ABSENT:
        return failures.port_absent(url=url, known_ports=known_ports())
    if number in (errno.EACCES, errno.EPERM):
        return failures.port_permission_denied(url=url, remedy=_permission_hint(url))
    is_invalid = any(isinstance(cause, _INVALID) for cause in causes)
    if scheme_of(url) != DEVICE and is_invalid:
        return failures.address_invalid(url=url, remedy=_form_hint(url))
    if number in (errno.ENOTTY, errno.EINVAL) or is_invalid:
        return failures.not_a_serial_port(url=url, known_ports=known_ports())
    reason = reason_of(failure).rstrip(".")
    if scheme_of(url) != DEVICE:
        return failures.nothing_at_address(url=url, reason=reason)
    return failures.port_cannot_be_opened(url=url, reason=reason, known_ports=known_ports())


def _form_hint(url: str) -> str:
    scheme = SCHEMES.get(scheme_of(url))
    if scheme is None:
        return f"Known addresses are {', '.join(known.form for known in SCHEMES.values())}."
    needs = f" It needs {scheme.needs}: {installing(scheme.needs)}." if scheme.needs else ""
    return f"The form is {scheme.form}.{needs}"


def _causes(failure: BaseException) -> list[BaseException]:
    """Return a failure and what it was raised from; pyserial nests up to three."""
    above = failure.__context__
    return [failure, *(_causes(above) if above is not None else [])]


def _number(cause: BaseException) -> int | None:
    """Return the number of the system's error; termios has it in `args`."""
    numbers = (getattr(cause, "errno", None), *cause.args[:1])
    return next((number for number in numbers if isinstance(number, int)), None)


def known_ports() -> str:
    """Return a sentence about the serial ports that this computer has."""
    names = [port.device for port in listed_ports()]
    return f"This computer has {', '.join(names)}." if names else "This computer lists no serial ports."


def _permission_hint(url: str) -> str:
    if sys.platform == "linux":
        return (
            f"Add yourself to the group of {url}, often dialout (`sudo usermod -aG dialout $USER`, then log in "
            "again), or install the udev rule docs/70-edmctl.rules."
        )
    return "Ask whoever looks after this computer for the right to use the port."
