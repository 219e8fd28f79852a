"""The receiving half of a session: bytes to frames, replies to whoever waits, reports to their subscribers."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from edmctl.link.frame import Frame, FrameDecoder
from edmctl.link.messages import UNSOLICITED, Advance, Boot, Heartbeat, HeartbeatReply

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.accounting import Statistics
    from edmctl.link.reports import Reports

REPLY = 0x40


class Receiver:
    """Takes the bytes of one session and counts what does not belong to it.

    `heard` becomes true with every sign of life of the controller; whoever looks sets it back. `others` is whether
    frames of another session have come since.
    """

    def __init__(
        self,
        session: int,
        statistics: Statistics,
        reports: Reports,
        on_heartbeat: Callable[[HeartbeatReply, int], None],
        on_boot: Callable[[Boot], None],
    ) -> None:
        self._session = session
        self._statistics = statistics
        self._reports = reports
        self._on_heartbeat = on_heartbeat
        self._on_boot = on_boot
        self._decoder = FrameDecoder(watch_for_abort=False)
        self._inbox: deque[Frame] = deque()
        self._waiting: dict[tuple[int, int], Frame | None] = {}
        self.heard = self.others = False

    def expect(self, type_id: int, seq: int) -> None:
        """Keep the reply to this command when it comes."""
        self._waiting[type_id | REPLY, seq] = None

    def reply(self, type_id: int, seq: int) -> Frame | None:
        """Return the reply to an expected command, None while there is none."""
        return self._waiting[type_id | REPLY, seq]

    def forget(self, type_id: int, seq: int) -> None:
        """Wait no longer."""
        del self._waiting[type_id | REPLY, seq]

    @property
    def pending(self) -> bool:
        """Whether frames are left that a raising subscriber kept from being handled."""
        return bool(self._inbox)

    def take(self, data: bytes) -> None:
        """Take the next bytes."""
        self._statistics.bytes_received += len(data)
        self._inbox.extend(self._decoder.feed(data))
        self._statistics.bad_frames = self._decoder.bad

    def dispatch(self) -> None:
        """Handle every frame that has come. What a subscriber raises comes out here and loses no other frame."""
        while self._inbox:
            self._dispatch(self._inbox.popleft())

    def _dispatch(self, frame: Frame) -> None:
        counts, kind = self._statistics, frame.type_id
        counts.frames_received += 1
        if kind == Boot.ID:
            self._boot(frame)
            return
        if frame.session != self._session:
            counts.other_session += 1
            self.others = True
            return
        if kind == Heartbeat.ID | REPLY:
            self._heartbeat(frame)
        elif kind in UNSOLICITED:
            self._hear()
            self._reports.take(frame)
        elif (kind, frame.seq) in self._waiting:
            self._hear()
            self._waiting[kind, frame.seq] = frame
        elif kind == Advance.ID | REPLY:
            return  # the driven line has seen it
        elif kind & REPLY:
            counts.stray_replies += 1
        else:
            counts.unknown_types += 1

    def _hear(self) -> None:
        self.heard, self.others = True, False

    def _heartbeat(self, frame: Frame) -> None:
        try:
            reply = HeartbeatReply.unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        self._hear()
        self._statistics.heartbeats_answered += 1
        self._on_heartbeat(reply, frame.seq)

    def _boot(self, frame: Frame) -> None:
        try:
            boot = Boot.unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        self._reports.take(frame)
        self._on_boot(boot)
