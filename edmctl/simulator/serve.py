"""Serves a virtual controller to programs that come through a pty or a socket: the object of `sim:`, the same bytes.

At a speed, the controller's time runs that many times as fast as the clock on the wall, and whatever watches the
host (watchdog, repetition of events) goes by the wall, also where this process stood still. Without a speed its
clock is driven: time stands still except where the host asks for some, so that a run is as fast as both sides can,
and always the same run.
"""

from __future__ import annotations

import re
import select
from collections.abc import Callable
from time import monotonic

from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.simulator.bench import VirtualBench
from edmctl.simulator.endpoints import Endpoint
from edmctl.simulator.injection import LineDamage
from edmctl.simulator.plant_interface import TICK_S

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
