"""A line over pyserial: serial ports, ptys, sockets and whatever else pyserial has a URL for.

One thread reads whatever is waiting, so that nothing is lost while the host is busy. All the ways in which a port
can fail become one `LinkLost`, and a line that failed once stays so.
"""

from __future__ import annotations

import os
import select
import socket
import threading
from contextlib import suppress
from time import monotonic

import serial

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import LinkLost
from edmctl.link import gate
from edmctl.link.ports import DEVICE, SOCKET, scheme_of

WRITE_TIMEOUT_S = 0.5
_READ_TIMEOUT_S = 0.05
"""How soon the reader of a port without a file descriptor sees that it should end."""
_MOST_BYTES = 65536


@dataclass(frozen=True, slots=True)
class Scheme:
    """What pyserial supports for the ports of one URL scheme.

    form : how such a port is written
    is_device : the port is a serial device, which can be locked and set to low latency
    write_timeout : a write that the port does not accept within the time fails
    needs : Python package without which pyserial does not know the scheme
    """

    form: str
    is_device: bool = False
    write_timeout: bool = True
    needs: str = ""


RFC2217 = "rfc2217"
SCHEMES = {
    DEVICE: Scheme("PORT", is_device=True),
    SOCKET: Scheme("socket://HOST:PORT"),
    RFC2217: Scheme("rfc2217://HOST:PORT", write_timeout=False),
    "alt": Scheme("alt://PORT?class=NAME", is_device=True),
    "hwgrep": Scheme("hwgrep://REGEXP", is_device=True),
    "spy": Scheme("spy://PORT?file=FILE", is_device=True),
    "cp2110": Scheme("cp2110://PATH", write_timeout=False, needs="hidapi"),
    "loop": Scheme("loop://"),
}
"""The ports that can be opened; a port that is named by its path, such as COM3, has the scheme `DEVICE`."""


def open_port(url: str, baud: int) -> serial.Serial:
    """Open a port with DTR and RTS set, so that no board is reset twice; a device is locked.

    Raises ValueError for a scheme that is not in `SCHEMES`, otherwise whatever pyserial raises.
    """
    name = scheme_of(url)
    scheme = SCHEMES.get(name)
    if scheme is None:
        raise ValueError(f"{name}:// is unknown")
    if name != DEVICE:  # pyserial compares the scheme of some URLs in lower case only
        url = f"{name}://{url.partition('://')[2]}"
    port: serial.Serial = serial.serial_for_url(
        url,
        baudrate=baud,
        timeout=_READ_TIMEOUT_S,
        write_timeout=WRITE_TIMEOUT_S if scheme.write_timeout else None,
        exclusive=True if scheme.is_device else None,
        do_not_open=True,
    )
    port.dtr = port.rts = True
    if name == SOCKET:
        # Opening would throw away what a server has said first.
        port.reset_input_buffer = lambda: None  # type: ignore[method-assign]
    port.open()
    if scheme.is_device:
        with suppress(Exception):  # not every system and driver has it
            port.set_low_latency_mode(True)
    elif name == SOCKET:
        # Small frames must not wait for the acknowledgement of the one before.
        with suppress(OSError), socket.socket(fileno=os.dup(port.fileno())) as same:
            same.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    elif name == RFC2217:
        port._socket.settimeout(WRITE_TIMEOUT_S)  # type: ignore[attr-defined] # pyserial has no setting for it
    return port


def reason_of(error: Exception) -> str:
    """Return why a port failed, in the words of the system where pyserial wraps them."""
    for cause in (error, error.__context__):
        text = getattr(cause, "strerror", None)
        if text and not text.startswith("could not open"):
            return str(text)
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)


class SerialLine:
    """An open port with its reader.

    Parameters
    ----------
    name : what people see in messages
    port : opened by `open_port`; the line closes it
    """

    live = True

    def __init__(self, name: str, port: serial.Serial) -> None:
        self.name = name
        self._port = port
        self._arrived = bytearray()
        self._news = threading.Condition()
        self._writing = threading.RLock()
        self._failure: LinkLost | None = None
        self._closed = False
        self._wake_r, self._wake_w = os.pipe()
        self._number = self._descriptor()
        self._reader = threading.Thread(target=self._read_on, name=f"reader of {name}", daemon=True)
        self._reader.start()

    def write(self, data: bytes) -> None:
        """Send bytes; LinkLost where the line is gone or takes nothing for half a second."""
        with self._writing:
            self._check()
            try:
                if self._number is None:
                    self._port.write(data)
                else:
                    _write_all(self._number, data)
            except (serial.SerialTimeoutException, TimeoutError):
                raise self._fail(
                    f"{self.name} takes no more bytes.", "Check that the controller runs, and its cable."
                ) from None
            except Exception as error:
                raise self._fail_by(error) from None

    def read(self, timeout_s: float) -> bytes:
        """Return as soon as anything is there, b"" after `timeout_s`; LinkLost at once where the line broke."""
        with self._news:
            if not self._arrived and self._failure is None:
                self._news.wait(timeout_s)
            if not self._arrived:
                self._check()
            data = bytes(self._arrived)
            self._arrived.clear()
        return data

    def now_s(self) -> float:
        return monotonic()

    def close(self) -> None:
        """End the reader and give the port back; more than once does no harm."""
        if self._closed:
            return
        self._closed = True
        os.write(self._wake_w, b"\0")
        if self._reader is not threading.current_thread():
            self._reader.join()
        # pyserial leaves a socket open whose other end has gone.
        its_socket = getattr(self._port, "_socket", None)
        with self._writing, suppress(Exception):
            self._fail(f"The line to {self.name} is closed.", "Open it again.")
            self._port.close()
        if its_socket is not None:
            its_socket.close()
        os.close(self._wake_r)
        os.close(self._wake_w)

    def _read_on(self) -> None:
        heard = False
        try:
            while not self._closed:
                data = self._waiting_bytes() if self._number is None else self._next_bytes(self._number)
                if data:
                    if not heard and data.startswith(gate.GREETING):
                        # A gate that spoke later than anybody waited for.
                        self._fail_with(gate.closed(self.name, gate.words_of(data.partition(b"\n")[0])))
                        return
                    heard = True
                    with self._news:
                        self._arrived += data
                        self._news.notify_all()
        except Exception as error:
            if not self._closed:
                self._fail_by(error)

    def _descriptor(self) -> int | None:
        """The port's file descriptor, where the OS can wait for it together with our own pipe."""
        # A spy shows only what goes through it.
        if os.name != "posix" or type(self._port).__module__.endswith("protocol_spy"):
            return None
        try:
            number: int = self._port.fileno()
        except (AttributeError, OSError):
            return None
        return number

    def _next_bytes(self, number: int) -> bytes:
        ready, _, _ = select.select([number, self._wake_r], [], [])
        if number not in ready:
            return b""
        data = os.read(number, _MOST_BYTES)
        if not data:
            raise OSError("it was unplugged, the other end closed it, or another program reads from it too")
        return data

    def _waiting_bytes(self) -> bytes:
        data: bytes = self._port.read(max(1, self._port.in_waiting))
        return data

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _fail_by(self, error: Exception) -> LinkLost:
        return self._fail(
            f"The line to {self.name} broke: {reason_of(error)}.",
            "Check cable and supply; the controller makes the machine safe by itself.",
        )

    def _fail(self, message: str, hint: str) -> LinkLost:
        return self._fail_with(failures.line_broken(problem=message, remedy=hint))

    def _fail_with(self, error: LinkLost) -> LinkLost:
        with self._news:
            if self._failure is None:
                self._failure = error
            self._news.notify_all()
            return self._failure


def _write_all(number: int, data: bytes) -> None:
    """Write to a descriptor that does not block; TimeoutError where it takes nothing for `WRITE_TIMEOUT_S`.

    pyserial's own write counts the time in which this computer stood still as the line's, and fails although every
    byte was taken (its issue 281).
    """
    while True:
        with suppress(BlockingIOError):
            data = data[os.write(number, data) :]
        if not data:
            return
        _, ready, _ = select.select([], [number], [], WRITE_TIMEOUT_S)
        if not ready:
            raise TimeoutError
