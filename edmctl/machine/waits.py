"""Waiting for the controller: in slices, each of which looks at news, faults, listeners and stop requests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from edmctl import failures
from edmctl.errors import EdmError, LinkLost, MachineFault
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import Fault, Status
from edmctl.link.session import Session
from edmctl.link.wire import Request
from edmctl.machine.faults import fault_error
from edmctl.machine.inbox import Inbox
from edmctl.machine.interface import (
    SLICE_S,
    EventCode,
    MachineEvent,
    MachineListener,
    MachineState,
    TouchRequest,
)
from edmctl.machine.plausibility import impossible
from edmctl.machine.queries import read_status
from edmctl.machine.stop import StopRequest

VIRTUAL_SLICE_S = 0.5
"""Where time is virtual, a wait looks around so often. It ends at once when an event or a fault has come, or samples
that are not those of a calm gap."""
GRACE_S = 5.0
"""How much longer than computed a motion may take before it counts as lost."""
SLOWEST = 4.0
"""Feeds are commanded in V/s by a mean gain; after a turning point the tool may be this much slower."""
STANDING_S = 2.0
"""A motion that has ended for so long, by the samples, and has not told, will not: reports are sent every 100 ms."""
FAULT_TOLD_S = 0.5
"""The report of a fault that the state shows already is there by then, unless the line loses it again and again."""

CUT_ENDS = (EventCode.CUT_DONE, EventCode.PATH_DONE, EventCode.TIME_UP, EventCode.STOPPED)
# Numbers: a sample holds no enum member, and is compared with them in every slice.
_CUTTING = tuple(map(int, (MachineState.MACHINING, MachineState.JUMP)))
_MOVING = tuple(map(int, (MachineState.APPROACH, MachineState.JUMP, MachineState.TOUCH, MachineState.MOVING)))


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
        self._begun_s = 0.0

    @property
    def slice_s(self) -> float:
        """How long a wait lasts until it looks around; samples that stay away shorten it."""
        is_long = not self._session.transport.live and not self._inbox.samples_are_late
        return VIRTUAL_SLICE_S if is_long else SLICE_S

    @property
    def now_s(self) -> float:
        """The clock that waiting goes by: the controller's."""
        return self._session.machine_now_s()

    def begin(self, command: Request[object]) -> None:
        """Send a motion command, where nothing forbids it; what earlier motions reported is of no interest to it."""
        self.look()
        self.retreat(command)

    def retreat(self, command: Request[object]) -> None:
        """Send a command that makes the machine safe, whatever has come in."""
        self._inbox.events.clear()
        with self.faults_first():
            self._session.request(command)
        self._begun_s = self._inbox.time_s

    @contextmanager
    def faults_first(self) -> Iterator[None]:
        """For a block that sends a command: where a fault is why it is refused or not answered, raise that fault.

        The refusal may come before the report of the fault that made it.
        """
        try:
            yield
        except CommandRefused as refused:
            if refused.status in (Status.BAD_STATE, Status.INTERLOCK):
                self._raise_what_is_latched()
            raise
        except LinkLost:
            if self._inbox.fault is not None:
                raise self._fault_error(self._inbox.fault) from None
            raise

    def _raise_what_is_latched(self) -> None:
        if self._inbox.fault is None:
            status = read_status(self._session)
            if status.state not in (MachineState.FAULT, MachineState.ESTOP):
                return
            told = self._session.pump_until(lambda: self._inbox.fault is not None, FAULT_TOLD_S)
            if not told:
                raise fault_error(status.fault, self.settings, port=self._session.transport.name)
        self._raise_what_came()

    def check_stop(self) -> None:
        self._stop.check()

    def look(self) -> None:
        """Read what waits on the line, and raise what must be raised before the tool or a stage moves."""
        self._session.catch_up()
        self._raise_what_came()

    def rest(self, duration_s: float) -> None:
        end_s = self.now_s + duration_s
        while (left_s := end_s - self.now_s) > 1e-6:
            self.slice(min(left_s, self.slice_s))

    def slice(self, duration_s: float) -> None:
        """Read for one slice or until there is news; then hand over, and raise what must be raised."""
        inbox = self._inbox
        inbox.news = False
        self._session.pump_until(lambda: inbox.news, duration_s, wakes=True)
        self.hand_over()
        self._raise_what_came()
        self._stop.check()

    def _raise_what_came(self) -> None:
        """Raise the fault that the controller reported, or that there is in what it says."""
        if self._inbox.fault is not None:
            raise self._fault_error(self._inbox.fault)
        if (found := self._inbox.doubts()) is not None:
            raise found

    def hand_over(self, *, everything: bool = False) -> None:
        """Give the listener what has come in; `everything` also empties the pulse buffers."""
        if self.listener is not None:
            self._inbox.deliver(self.listener, everything=everything)

    def take_event(self, codes: tuple[EventCode, ...]) -> MachineEvent | None:
        """Return the oldest event of these kinds that no wait has taken yet."""
        for event in self._inbox.events:
            if event.code in codes:
                self._inbox.events.remove(event)
                return event
        return None

    def event(self, codes: tuple[EventCode, ...], expected_s: float) -> MachineEvent:
        """Wait for one of these events, `expected_s` and some grace at most; MachineFault when none comes."""
        grace_s = GRACE_S * self._session.pace
        begun_s, deadline_s = self._inbox.time_s, self.now_s + expected_s + grace_s
        while (event := self.take_event(codes)) is None:
            self._refuse_strange(codes)
            if self.now_s > deadline_s or self._stands_since(begun_s, _MOVING):
                raise _not_reported(codes, f"within {expected_s + grace_s:.1f} s")
            self.slice(min(self.slice_s, max(SLICE_S, deadline_s - self.now_s)))
        return event

    def cut(self, duration_s: float) -> MachineEvent | None:
        """Wait for the end of a cut for one slice; None while it goes on, MachineFault where it has ended untold."""
        self.slice(duration_s)
        event = self.take_event(CUT_ENDS)
        if event is None:
            self._refuse_strange(CUT_ENDS)
            if self._stands_since(self._begun_s, _CUTTING):
                raise _not_reported(CUT_ENDS, f"for {STANDING_S:.0f} s, and nothing sparks any more")
        return event

    def _refuse_strange(self, codes: tuple[EventCode, ...]) -> None:
        """Raise where something is reported to have ended that was not under way. A cut may end while it jumps."""
        for event in self._inbox.events:
            if event.code not in codes and event.code not in CUT_ENDS:
                raise impossible(f"{event.code.name} while {codes[0].name} is due")

    def _stands_since(self, begun_s: float, moving: tuple[int, ...]) -> bool:
        """Whether the samples show, and have for a while, a state that is none of these."""
        inbox = self._inbox
        still = inbox.state not in moving
        stood_s = inbox.time_s - max(inbox.state_since_s, begun_s)
        return still and stood_s > STANDING_S * self._session.pace

    def event_whatever_comes(self, code: EventCode, timeout_s: float) -> None:
        """Wait for an event; no fault, stop request or listener comes between."""
        self._session.pump_until(lambda: any(e.code == code for e in self._inbox.events), timeout_s)

    def _fault_error(self, fault: Fault) -> EdmError:
        where = f" ({fault.displacement_um:.1f} µm, {fault.gap_v:.1f} V at {self._inbox.time_s:.1f} s)"
        error = fault_error(fault.code, self.settings, where, port=self._session.transport.name)
        if isinstance(error, MachineFault):
            error.detail = fault.detail
        return error


def _not_reported(codes: tuple[EventCode, ...], when: str) -> MachineFault:
    wanted = " or ".join(code.name for code in codes)
    return failures.state_not_reached(wanted=wanted, when=when)


def touch_time_s(request: TouchRequest) -> float:
    """Return the longest time to the next contact: the fast leg, the slow leg, the hunting."""
    fast_s = max(request.fast_to_um, 0.0) / request.fast_um_s
    slow_s = (request.z_max_um - request.fast_to_um) / request.speed_um_s
    return SLOWEST * (fast_s + slow_s + request.back_off_um / request.speed_um_s) + request.dwell_s
