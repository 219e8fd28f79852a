"""The board's line as the host sees it, with what only a simulator's line does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.messages import Clock, Hello, HelloReply, Reboot, Status, Tlm
from edmctl.simulator.plant_records import TICK_S

from .line import UNHURRIED

if TYPE_CHECKING:
    from edmctl.link.frame import Frame

    from .controller import Stm32Controller

REPLY_BIT = 0x40
SIMULATED = 0
"""Board that HELLO tells, whatever the image says."""


class Stm32Link:
    """The board's end of the line, with what only a simulator's line does."""

    answer_ticks = 4
    """Milliseconds within which a command is answered."""

    def __init__(self, controller: Stm32Controller) -> None:
        self._c = controller
        self._decoder = FrameDecoder(watch_for_abort=False)
        self._partial = b""
        self._out: list[bytes] = []
        self.driven = False
        self.urgent = self.due = False
        self.advanced = False
        self.reboots = False  # it has said that it will restart
        self.awaited: tuple[int, int] | None = None  # type and seq of a reply

    @property
    def greeting(self) -> bool:
        """Whether somebody waits for an answer on a driven clock that nobody drives yet."""
        return self.driven and self.urgent and not self.advanced

    @property
    def rx_frames(self) -> int:
        """Commands that came whole, whoever sent them."""
        return self._c.word("link.frames")

    @property
    def rx_bad(self) -> int:
        """Frames dropped for a bad check."""
        return self._c.word("receiver.bad")

    @property
    def rx_drop(self) -> int:
        """Frames dropped for another reason."""
        return self._c.word("link.drop")

    def sent(self, data: bytes) -> None:
        """Take bytes that the board has sent; frames are lined up whole."""
        *whole, self._partial = (self._partial + data).split(b"\0")
        for piece in whole:
            if piece:
                self._line_up(b"\0" + piece + b"\0")

    def _line_up(self, data: bytes) -> None:
        frame = next(iter(self._decoder.feed(data)), None)
        if frame is not None:
            self.urgent = self.urgent or frame.type_id not in UNHURRIED
            if frame[:2] == self.awaited:
                self.awaited = None
            self.reboots = self.reboots or (frame.type_id, frame.flags) == (Reboot.ID | REPLY_BIT, Status.OK)
            if frame.type_id == Hello.ID | REPLY_BIT:
                self.advanced = False
                if frame.flags in (Status.OK, Status.VERSION):
                    told = HelloReply.unpack(frame.payload)
                    told.board = SIMULATED  # no result of it may pass for one of a machine
                    told.clock = Clock.DRIVEN if self.driven else told.clock
                    data = encode_frame(*frame[:4], told.pack())
            data = self._c.telemetry.passes(frame, data)
        if data:
            self._out.append(data)

    def answer(self, data: bytes) -> None:
        """Send an answer that the board did not give."""
        self._out.append(data)
        self.due = True

    def take_output(self) -> bytes:
        """Hand over everything to be sent."""
        out = b"".join(self._out)
        self._out.clear()
        self.urgent = self.due = False
        return out


class Samples:
    """What can be wrong with a controller's samples: `lost` ones do not come, `frozen` ones tell an old time."""

    def __init__(self) -> None:
        self.lost = self.frozen = False
        self._before = b""  # payload of the last ones that told their own time

    def passes(self, frame: Frame, data: bytes) -> bytes:
        """Return what is sent of a frame, whose bytes are `data`."""
        if frame.type_id != Tlm.ID:
            return data
        if self.lost:
            return b""
        if not self.frozen:
            self._before = frame.payload
            return data
        samples = Tlm.unpack(frame.payload)
        samples.t0_us = Tlm.unpack(self._before).t0_us if self._before else 0
        return encode_frame(*frame[:4], samples.pack())


class Waiting:
    """Lets time pass for a host that waits: until an answer is there, at most as long as it would."""

    def __init__(self, controller: Stm32Controller) -> None:
        self._c = controller

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass, in whole milliseconds, at least one."""
        self._c.run(max(1, math.floor(timeout_s / TICK_S + 0.5)), stops_when_sent=True)
