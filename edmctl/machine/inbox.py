"""What the controller sent and nobody has handled yet: samples, pulses, events, a fault."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

from edmctl.link.messages import Event, EventCode, Fault, Log, PulseBlocks, Pulses, Tlm
from edmctl.machine.decode import ToSeconds, lost_frames, pulse_batches, pulse_block_batch, telemetry_block
from edmctl.machine.port import MachineEvent, MachineListener

if TYPE_CHECKING:
    from collections.abc import Callable

_PULSE_FRAMES = 16
"""Pulse frames gathered before they are handed on: they are only recorded, so they may wait."""

_M = TypeVar("_M")


class Subscribable(Protocol):
    """The part of a session that unsolicited messages come from."""

    def subscribe(self, message_type: type[_M], callback: Callable[[_M], None]) -> None:
        """Call `callback` with every message of this type."""


class Inbox:
    """Collects unsolicited messages while the session reads, and hands them to the listener between reads.

    Nothing but collecting happens inside the session's callbacks, so an error of a listener (a full disk)
    surfaces in the procedure that waits and never in the middle of a frame.

    `events` holds what no wait has taken yet; `news` is set by every event and fault, for the waits to clear.
    """

    def __init__(self, session: Subscribable, to_seconds: ToSeconds) -> None:
        self._to_seconds = to_seconds
        self._telemetry: list[Tlm] = []
        self._blocks: list[PulseBlocks] = []
        self._pulses: list[Pulses] = []
        self._logs: list[Log] = []
        self._unheard: list[MachineEvent] = []
        self._telemetry_counter: int | None = None
        self.events: list[MachineEvent] = []
        self.fault: Fault | None = None
        self.news = False
        self.time_s = 0.0
        session.subscribe(Tlm, self._telemetry.append)
        session.subscribe(PulseBlocks, self._blocks.append)
        session.subscribe(Pulses, self._pulses.append)
        session.subscribe(Log, self._logs.append)
        session.subscribe(Event, self._on_event)
        session.subscribe(Fault, self._on_fault)

    def _on_event(self, message: Event) -> None:
        event = MachineEvent(
            code=EventCode(message.code),
            time_s=self._to_seconds(message.t_us),
            argument=message.arg,
            displacement_um=message.displacement_um,
            actuator_v=message.actuator_v,
        )
        self.news = True
        self.events.append(event)
        self._unheard.append(event)

    def _on_fault(self, message: Fault) -> None:
        self.news = True
        if self.fault is None:
            self.fault = message

    def is_news(self) -> bool:
        """Whether an event or a fault came that a wait must not sleep over."""
        return self.news

    def restart_telemetry(self) -> None:
        """Take the next telemetry frame as the first."""
        self._telemetry_counter = None

    def deliver(self, listener: MachineListener, *, everything: bool = False) -> None:
        """Hand on what has come in; `everything` also empties the pulse buffers."""
        if self._telemetry:
            self._deliver_telemetry(listener)
        for event in self._unheard:
            listener.event(event)
            self.time_s = max(self.time_s, event.time_s)
        self._unheard.clear()
        for line in self._logs:
            listener.log(line.level, line.text)
        self._logs.clear()
        threshold = 1 if everything else _PULSE_FRAMES
        if len(self._blocks) >= threshold:
            batch = pulse_block_batch(self._blocks, self._to_seconds)
            self._blocks.clear()
            listener.pulse_blocks(batch)
        if len(self._pulses) >= threshold:
            batches = pulse_batches(self._pulses, self._to_seconds)
            self._pulses.clear()
            for train in batches:
                listener.pulses(train)

    def _deliver_telemetry(self, listener: MachineListener) -> None:
        counters = [frame.counter for frame in self._telemetry]
        missing = lost_frames(self._telemetry_counter, counters)
        self._telemetry_counter = counters[-1]
        block = telemetry_block(self._telemetry, self._to_seconds, missing)
        self._telemetry.clear()
        self.time_s = float(block.time_s[-1])
        listener.telemetry(block)
