"""Waiting for the controller: in slices, each of which looks at news, faults, listeners and stop requests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import MachineFault
from edmctl.machine.faults import fault_error

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.errors import EdmError
    from edmctl.link.messages import Fault
    from edmctl.link.session import Session
    from edmctl.link.wire import Request
    from edmctl.machine.inbox import Inbox
    from edmctl.machine.orders import TouchRequest
    from edmctl.machine.port import EventCode, MachineEvent, MachineListener
    from edmctl.machine.stop import StopRequest

SLICE_S = 0.1
"""A wait looks around this often."""
GRACE_S = 5.0
"""How much longer than computed a motion may take before it counts as lost."""
SLOWEST = 4.0
"""Feeds are commanded in V/s by a mean gain; after a turning point the tool may be this much slower."""


class Waits:
    """Sends motion commands and waits for the events that end them.

    `settings` are the controller's parameters, for the messages of faults; `listener` hears what comes in.
    """

    def __init__(
        self, session: Session, inbox: Inbox, stop: StopRequest, settings: Mapping[str, float]
    ) -> None:
        self._session = session
        self._inbox = inbox
        self._stop = stop
        self.settings = settings
        self.listener: MachineListener | None = None

    @property
    def now_s(self) -> float:
        """The clock that waiting goes by: the controller's."""
        return self._session.machine_now_s()

    def begin(self, command: Request[object]) -> None:
        """Send a motion command; what earlier motions reported is of no interest to it."""
        self._inbox.events.clear()
        self._session.request(command)

    def rest(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = self.now_s + duration_s
        while (left_s := end_s - self.now_s) > 1e-6:
            self.slice(min(left_s, SLICE_S))

    def slice(self, duration_s: float) -> None:
        """Read for one slice or until there is news; then hand over, and raise what must be raised."""
        inbox = self._inbox
        inbox.news = False
        self._session.pump_until(inbox.is_news, duration_s)
        self.hand_over()
        if inbox.fault is not None:
            raise self._fault_error(inbox.fault)
        self._stop.check()

    def hand_over(self, *, everything: bool = False) -> None:
        """Give the listener what has come in; `everything` also empties the pulse buffers."""
        if self.listener is not None:
            self._inbox.deliver(self.listener, everything=everything)

    def take(self, codes: tuple[EventCode, ...]) -> MachineEvent | None:
        """The oldest event of these kinds that no wait has taken yet."""
        for event in self._inbox.events:
            if event.code in codes:
                self._inbox.events.remove(event)
                return event
        return None

    def event(self, codes: tuple[EventCode, ...], expected_s: float) -> MachineEvent:
        """Wait for one of these events, `expected_s` and some grace at most; MachineFault when none comes."""
        deadline_s = self.now_s + expected_s + GRACE_S
        while (event := self.take(codes)) is None:
            if self.now_s > deadline_s:
                wanted = " or ".join(code.name for code in codes)
                raise MachineFault(
                    f"The controller did not report {wanted} within {expected_s + GRACE_S:.1f} s.",
                    hint="The tool was told to retract. Look at the controller's log before the next run.",
                    code="E6001",
                )
            self.slice(SLICE_S)
        return event

    def event_whatever_comes(self, code: EventCode, timeout_s: float) -> None:
        """Wait for an event; no fault, stop request or listener comes between."""
        self._session.pump_until(lambda: any(e.code == code for e in self._inbox.events), timeout_s)

    def _fault_error(self, fault: Fault) -> EdmError:
        where = f" ({fault.displacement_um:.1f} µm, {fault.gap_v:.1f} V at {self._inbox.time_s:.1f} s)"
        return fault_error(fault.code, self.settings, where, port=self._session.transport.name)


def touch_time_s(request: TouchRequest) -> float:
    """Longest time to the next contact: the fast leg, the slow leg, the hunting."""
    fast_s = max(request.fast_to_um, 0.0) / request.fast_um_s
    slow_s = (request.z_max_um - request.fast_to_um) / request.speed_um_s
    return SLOWEST * (fast_s + slow_s + request.back_off_um / request.speed_um_s) + request.dwell_s
