"""Serves a virtual controller, with the same bytes as `sim:`, on a pty under a name or on a TCP socket.

At a speed, the controller's time is that many times as fast as the clock on the wall, and whatever watches the host
(watchdog, repetition of events) uses the wall clock, also while this process did not run. Without a speed its clock
is driven: time passes only when the host asks for it, so that a run is as fast as both sides can, and reproducible.
"""

from __future__ import annotations

import hmac
import os
import re
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
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.simulator.bench import VirtualBench
from edmctl.simulator.injection import LineDamage
from edmctl.simulator.plant_records import TICK_S

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


SLICE_S = 0.004
"""How long the clock waits for bytes before it goes on."""
MOST_BEHIND_S = 0.25
"""A clock that is later than this is not caught up with but set back: machine and work have paused."""
ORPHANED_S = 2.0
"""A driven clock without anybody who drives it goes on by itself after this, until the machine is safe."""
MOST_WAITING = 65536
"""Bytes that wait for a client which does not read; beyond them whole frames are dropped, as a UART does."""
MOST_AT_ONCE_S = 0.02
"""So much is caught up with before the line is read again: what waits there feeds the watchdog."""
_IDLE_S = 0.2
_PARTS = re.compile(rb"\0+|[^\0]+\0?")


@dataclass(slots=True)
class Traffic:
    """Frames both ways, frames that a client did not fetch, and how the clock kept up with the wall's.

    slowest_s : longest time that the controller's clock was late. paused_s : time by which it was set back.
    """

    frames_in: int = 0
    frames_out: int = 0
    dropped_frames: int = 0
    slowest_s: float = 0.0
    paused_s: float = 0.0


class Server:
    """One controller on one endpoint.

    bench : what is served, from client to client. endpoint : where; the caller closes it.
    speed : controller seconds per second, None for a driven clock.
    each_turn : called after every turn of the loop, a few milliseconds apart.
    say : called once if the computer is too slow for the speed.
    """

    def __init__(
        self,
        bench: VirtualBench,
        endpoint: Endpoint,
        speed: float | None = 1.0,
        each_turn: Callable[[], None] = lambda: None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._bench, self._endpoint, self._speed = bench, endpoint, speed
        self._each_turn, self._say = each_turn, say
        self._in_frame = self._is_late = False
        self._controller = bench.controller
        self._line = bench.line
        self._damage = LineDamage(bench.line)
        self._waiting = bytearray()
        self.traffic = Traffic()
        self._controller.link.driven = speed is None
        self._controller.host_time_scale = speed or 1.0
        self._heard_s = self._base_s = self._looked_s = self._answer_by_s = monotonic()
        self._base_tick = self._controller.tick

    def run(self, is_over: Callable[[], bool]) -> None:
        """Serve until `is_over` says so, or the line is unplugged by an injection."""
        self._base_s = self._looked_s = monotonic()
        self._base_tick = self._controller.tick
        while not is_over() and not self._line.unplugged:
            self.turn()

    def turn(self) -> None:
        """Look at the line, let time pass, execute what came, send what there is to send."""
        self._wait()
        data = self._endpoint.receive()
        if self._speed is not None:
            # Bytes that piled up while nobody looked must not pass for a host that was watched all the time.
            self._look_after_stall()
            self._follow_clock(self._speed)
        self._take(data)
        if self._speed is None:
            self._look_after_orphan()
        self._transmit()
        self._each_turn()

    def _wait(self) -> None:
        writers = self._endpoint.descriptors()[-1:] if self._waiting else []
        if self._speed is None:
            patience_s = _IDLE_S
        elif self._is_late:
            patience_s = 0.0
        else:  # an answer on its way is not to wait for the end of a slice
            patience_s = TICK_S if monotonic() < self._answer_by_s else SLICE_S
        select.select(self._endpoint.descriptors(), writers, [], patience_s)

    def _look_after_stall(self) -> None:
        """Trip the watchdog of an armed machine where the line was not looked at for the watchdog's time."""
        now_s = monotonic()
        away_s, self._looked_s = now_s - self._looked_s, now_s
        if self._controller.armed and away_s >= self._controller.parameters.watchdog_ticks * TICK_S:
            self._say(f"this computer was away for {away_s:.1f} s: to the machine its host was silent")
            self._controller.raise_fault(FaultCode.HOST_SILENT)

    def _follow_clock(self, speed: float) -> None:
        """Let the controller's clock catch up with the wall's, in small steps where it is late."""
        now_s = monotonic()
        behind_s = now_s - self._base_s - (self._controller.tick - self._base_tick) * TICK_S / speed
        self.traffic.slowest_s = max(self.traffic.slowest_s, behind_s)
        if behind_s > MOST_BEHIND_S:
            if not self.traffic.paused_s:
                self._say(
                    f"this computer was away, or is too slow for {speed:g}x: the controller's clock is set back"
                )
            self.traffic.paused_s += behind_s
            self._base_s += behind_s
            self._is_late = False
            return
        self._is_late = behind_s > MOST_AT_ONCE_S
        ticks = int(min(behind_s, MOST_AT_ONCE_S) * speed / TICK_S)
        if ticks > 0:
            self._controller.advance(ticks)

    def _take(self, data: bytes) -> None:
        if not data:
            return
        self._heard_s = monotonic()
        self._answer_by_s = self._heard_s + self._controller.link.answer_ticks * TICK_S
        self._count_frames(data)
        # One by one: what a frame or a run of zeros brings about comes before the frame behind it, however the
        # bytes were read.
        before = self._controller.link.rx_frames
        for part in _PARTS.findall(data):
            self._controller.receive(self._damage.to(part))
        if self._controller.link.rx_frames != before:
            self._endpoint.heard()
        if self._controller.link.greeting:
            # An answer before the first ADVANCE counts as one that was waited for.
            self._controller.host_wait.wait(0.0)

    def _count_frames(self, data: bytes) -> None:
        *ended, rest = ((b"x" if self._in_frame else b"") + data).split(b"\0")
        self.traffic.frames_in += sum(1 for part in ended if part)
        self._in_frame = bool(rest)

    def _look_after_orphan(self) -> None:
        if self._bench.is_safe or monotonic() - self._heard_s < ORPHANED_S or self._endpoint.has_client():
            return
        self._bench.settle()

    def _transmit(self) -> None:
        port = self._controller.link
        if self._speed is not None or port.due:
            self._queue(port.take_output())
        while self._waiting:
            sent = self._endpoint.transmit(bytes(self._waiting[:MOST_WAITING]))
            if not sent:
                return
            del self._waiting[:sent]

    def _queue(self, data: bytes) -> None:
        """Line up what is to be sent; a client that does not read loses whole frames, unless time waits for it."""
        frames = data.count(b"\0") // 2
        if self._speed is None or len(self._waiting) + len(data) <= MOST_WAITING:
            self._waiting += data
            self.traffic.frames_out += frames
        else:
            self.traffic.dropped_frames += frames


class EventMonitor:
    """Reports what happens to a served machine, as it happens: call it often.

    rested : called when a machine that was armed is not any more.
    faults : codes of the faults latched since the start, in order.
    """

    def __init__(
        self, bench: VirtualBench, say: Callable[[str], None], rested: Callable[[], None] = lambda: None
    ) -> None:
        self._controller = bench.controller
        self._say, self._rested = say, rested
        self._injected = 0
        self._fault = self._controller.fault
        self._armed = False
        self.faults: list[int] = []
        if self._fault:
            say(f"{_fault_text(self._fault)} is latched from before")

    def __call__(self) -> None:
        """Report what is new."""
        controller = self._controller
        applied = controller.injector.applied
        for injection, tick in applied[self._injected :]:
            self._say(f"{tick * TICK_S:.3f} s: {injection} happened")
        self._injected = len(applied)
        fault, before = controller.fault, self._fault
        if fault != before:
            self._fault, tick = fault, controller.tick
            if fault:
                self.faults.append(fault)
                frozen_tick = controller.black_box.frozen_tick
                tick = tick if frozen_tick in (None, -1) else frozen_tick
            text = f"{_fault_text(fault)} latched" if fault else f"{_fault_text(before)} cleared"
            self._say(f"{tick * TICK_S:.3f} s: {text}")
        if self._armed and not controller.armed:
            self._rested()
        self._armed = controller.armed


def _fault_text(code: int) -> str:
    return f"fault {code} {FAULTS[code].name}"
