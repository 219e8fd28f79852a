"""Hands on what the controller sends by itself: everything once and in order, telemetry gaps counted."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from edmctl.link.messages import UNSOLICITED, Event, Fault, PulseBlocks, Pulses, Tlm

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.accounting import Statistics
    from edmctl.link.frame import Frame

_COUNTER_WRAP = 1 << 16
_LAST_EVENT_NO = 0xFFFF
_FAR_EVENTS = 1000
"""No controller keeps so many events: a number further from the last one is none."""

MessageT = TypeVar("MessageT")


class Reports:
    """Subscribers, telemetry counters, and the last event, which heartbeats acknowledge (0: none yet)."""

    def __init__(self) -> None:
        self._subscribers: dict[type, list[Callable[..., None]]] = {}
        self._next_counter: dict[type, int] = {}
        self.last_event = 0

    def begin(self, statistics: Statistics) -> None:
        """Start a session; subscribers stay."""
        self._statistics = statistics
        self.last_event = 0
        self.restart_counters()

    def restart_counters(self) -> None:
        """Take the next frame of each kind of telemetry as its first."""
        self._next_counter.clear()

    def subscribe(self, message_type: type[MessageT], callback: Callable[[MessageT], None]) -> None:
        """Call `callback` with every message of one type."""
        self._subscribers.setdefault(message_type, []).append(callback)

    def take(self, frame: Frame) -> None:
        """Deliver one frame of a type in UNSOLICITED."""
        try:
            message = UNSOLICITED[frame.type_id].unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        if isinstance(message, Tlm | PulseBlocks | Pulses):
            if not self._is_newer(message):
                self._statistics.repeated_frames += 1
                return
        elif isinstance(message, Event | Fault) and not self._is_due(message.event_no):
            return
        for callback in self._subscribers.get(type(message), ()):
            callback(message)

    def _is_newer(self, message: Tlm | PulseBlocks | Pulses) -> bool:
        """Whether a frame is none that came before, or was overtaken; counts what is missing before it."""
        kind, counter = type(message), message.counter
        missing = (counter - self._next_counter.get(kind, counter)) % _COUNTER_WRAP
        if missing >= _COUNTER_WRAP // 2:
            return False
        self._next_counter[kind] = (counter + 1) % _COUNTER_WRAP
        if missing:
            lost = self._statistics.lost_frames
            lost[message.NAME] = lost.get(message.NAME, 0) + missing
        return True

    def _is_due(self, event_no: int) -> bool:
        # One after a gap must wait: acknowledging it would acknowledge the lost one before it.
        ahead = (event_no - self.last_event - 1) % _LAST_EVENT_NO
        if event_no == 0 or (self.last_event and _FAR_EVENTS < ahead < _LAST_EVENT_NO - _FAR_EVENTS):
            self._statistics.malformed += 1
            return False
        if self.last_event and ahead:
            self._statistics.repeated_events += 1
            return False
        self.last_event = event_no
        return True
