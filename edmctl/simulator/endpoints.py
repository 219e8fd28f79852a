"""Where a served controller can be reached: a pty under a name, or a TCP socket for one client after the other."""

from __future__ import annotations

import hmac
import os
import secrets
import select
import socket
import tty
from collections.abc import Callable
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from time import monotonic
from typing import Protocol

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.link import gate

SILENT_S = 5.0
"""A client that has sent no valid frame for this time makes room for the next one."""
GATE_S = 5.0
"""A client that has not answered the challenge by then is turned away."""
MOST_AT_GATE = 16
_MOST_A_TURN = 64
_MOST_READ = 65536


class Endpoint(Protocol):
    """One end of a line, with at most one client at a time. Nothing here blocks.

    name : what a client opens. descriptors : what to wait on for `receive`, which returns b"" if nothing came.
    transmit : returns the number of bytes that the line took. heard : the client has sent a valid frame.
    """

    name: str

    def descriptors(self) -> list[int]: ...
    def receive(self) -> bytes: ...
    def transmit(self, data: bytes) -> int: ...
    def heard(self) -> None: ...
    def has_client(self) -> bool: ...
    def close(self) -> None: ...


class PtyEndpoint:
    """A pseudo-terminal; clients open `link`, a symbolic link to it, as they open a serial port.

    Raises LinkLost E4021 if `link` is something else already.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.device = os.ttyname(self._theirs)
        self._link = link
        self.name = str(link or self.device)
        if link is None:
            return
        try:
            if link.is_symlink() and (not link.exists() or link.readlink() == Path(self.device)):
                link.unlink()  # of a dead server: it leads nowhere, or to this very device
            link.symlink_to(self.device)
        except OSError as error:
            os.close(self._ours)
            os.close(self._theirs)
            raise failures.link_cannot_be_made(link=link, reason=error.strerror) from error

    def descriptors(self) -> list[int]:
        return [self._ours]

    def receive(self) -> bytes:
        try:
            return os.read(self._ours, _MOST_READ)
        except BlockingIOError:
            return b""
        except OSError:  # a client that had the device to itself is gone
            self._hold()
            return b""

    def transmit(self, data: bytes) -> int:
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0

    def heard(self) -> None:
        """Do nothing: whoever opens a terminal has it."""

    def has_client(self) -> bool:
        """Return whether somebody has the device open: one that nobody holds reports that it was hung up."""
        os.close(self._theirs)
        try:
            poll = select.poll()
            poll.register(self._ours, select.POLLIN)
            return not any(events & select.POLLHUP for _, events in poll.poll(0))
        finally:
            self._hold()

    def _hold(self) -> None:
        """Keep the other end open, so that a client which closes it does not hang up."""
        try:
            self._theirs = os.open(self.device, os.O_RDWR | os.O_NOCTTY)
        except OSError:  # a client has the device to itself
            self._theirs = os.dup(self._ours)

    def close(self) -> None:
        if self._link is not None:
            with suppress(OSError):
                if self._link.readlink() == Path(self.device):
                    self._link.unlink()
        for number in (self._ours, self._theirs):
            with suppress(OSError):
                os.close(number)


@dataclass(slots=True)
class _AtGate:
    """Somebody who was asked for the secret."""

    client: socket.socket
    address: str
    number: bytes
    since_s: float
    received: bytes = b""


class SocketEndpoint:
    """A TCP socket with one client at a time, with a `secret` only one that knows it.

    While the client sends valid frames (`heard`), others are refused as it is busy. Raises LinkLost E4021 if the
    address cannot be taken.
    """

    def __init__(
        self, host: str, port: int, say: Callable[[str], None] = lambda _: None, secret: bytes = b""
    ) -> None:
        self._say = say
        self._secret = secret
        self._client: socket.socket | None = None
        self._heard_s = 0.0
        self._turned_away = 0
        self._at_gate: list[_AtGate] = []
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._listener = socket.create_server((host, port), family=family)
        except (OSError, UnicodeError, TypeError) as error:
            reason = getattr(error, "strerror", None) or "no such host"
            raise failures.socket_cannot_be_served(host=host, port=port, reason=reason) from error
        self._listener.setblocking(False)
        address = self._listener.getsockname()
        shown = f"[{address[0]}]" if ":" in address[0] else address[0]
        self.name = f"socket://{shown}:{address[1]}"

    def descriptors(self) -> list[int]:
        """The listener, whoever is asked for the secret, and the client where there is one."""
        every = (self._listener, *(waiting.client for waiting in self._at_gate), self._client)
        return [s.fileno() for s in every if s is not None]

    def heard(self) -> None:
        self._heard_s = monotonic()

    def receive(self) -> bytes:
        """Take clients or turn them away; return what the present one has sent."""
        data = None if self._client is None else _received(self._client, _MOST_READ)
        if data == b"":  # gone: it must not keep others out
            self._drop_client()
        self._accept()
        self._look_at_gate()
        return data or b""

    def transmit(self, data: bytes) -> int:
        """Send as much as the socket takes; without a client all of it goes nowhere."""
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop_client()
            return len(data)

    def has_client(self) -> bool:
        return self._client is not None

    def close(self) -> None:
        self._drop_client()
        for waiting in self._at_gate:
            waiting.client.close()
        self._at_gate.clear()
        self._listener.close()

    def _accept(self) -> None:
        for _ in range(_MOST_A_TURN):
            try:
                client, (host, port, *_) = self._listener.accept()
            except OSError:
                return
            client.setblocking(False)
            address = f"{host}:{port}"
            if self._is_busy():
                self._turn_away(client, address, gate.BUSY)
            elif self._secret:
                if len(self._at_gate) >= MOST_AT_GATE:  # the oldest has had the longest time to answer
                    oldest = self._at_gate.pop(0)
                    self._turn_away(oldest.client, oldest.address, gate.REFUSED)
                number = secrets.token_hex(16).encode()
                _send(client, gate.line_of(gate.CHALLENGE, number))
                self._at_gate.append(_AtGate(client, address, number, monotonic()))
            else:
                self._take(client, address)

    def _is_busy(self) -> bool:
        return self._client is not None and monotonic() - self._heard_s < SILENT_S

    def _look_at_gate(self) -> None:
        for waiting in tuple(self._at_gate):
            more = _received(waiting.client, gate.LONGEST_LINE)
            waiting.received += more or b""
            is_over = more == b"" or monotonic() - waiting.since_s > GATE_S
            if b"\n" not in waiting.received and len(waiting.received) < gate.LONGEST_LINE and not is_over:
                continue
            self._at_gate.remove(waiting)
            answer = gate.words_of(waiting.received.partition(b"\n")[0])
            right = gate.answer_to(waiting.number, self._secret)
            if len(answer) != 2 or answer[0] != gate.ANSWER or not hmac.compare_digest(answer[1], right):
                self._turn_away(waiting.client, waiting.address, gate.REFUSED)
            elif self._is_busy():
                self._turn_away(waiting.client, waiting.address, gate.BUSY)
            else:
                _send(waiting.client, gate.line_of(gate.READY))
                self._take(waiting.client, waiting.address)

    def _take(self, client: socket.socket, address: str) -> None:
        if self._client is not None:
            self._say(f"the client before has been silent for {SILENT_S:g} s and makes room for {address}")
            self._drop_client()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client
        self.heard()

    def _turn_away(self, client: socket.socket, address: str, why: bytes) -> None:
        _send(client, gate.line_of(why))
        client.close()
        self._turned_away += 1
        # Reported whenever their number has doubled: a log cannot be filled from outside.
        if self._turned_away & (self._turned_away - 1) == 0:
            reason = "busy" if why == gate.BUSY else "without the secret"
            self._say(f"turned away {address} ({reason}), {self._turned_away} in all")

    def _drop_client(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def address_of(host: str) -> str:
    """Return the address that a host's name stands for now. Raises LinkLost E4021 where there is none."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        return str(found[0][4][0])
    except (OSError, UnicodeError, ValueError) as error:
        raise failures.host_unknown(host=host) from error


def is_loopback(address: str) -> bool:
    """Whether only this computer reaches an address."""
    return ip_address(address.partition("%")[0]).is_loopback


def _received(client: socket.socket, most: int) -> bytes | None:
    """Return what a client has sent; None if nothing has come, b"" if it is gone."""
    try:
        return client.recv(most)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def _send(client: socket.socket, line: bytes) -> None:
    """Send a line to somebody who may be gone; it fits into any socket's buffer."""
    with suppress(OSError):
        client.send(line)
