"""What a session needs of a line: bytes both ways, and the clock that waiting goes by; a line in stepped time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import LinkLost
from edmctl.link.frame import Frame, FrameDecoder, encode_frame
from edmctl.link.messages import Advance, AdvanceReply, Status, Tlm


class Transport(Protocol):
    """A byte stream to one controller.

    `name` is what people see in messages. `live` is true where `now_s` is the computer's own clock, which goes on
    whatever the host does; otherwise time passes only while the host reads.
    """

    @property
    def name(self) -> str:
        """What people see."""
        ...

    @property
    def live(self) -> bool:
        """Whether time passes by itself."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes; LinkLost where the line is gone."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return as soon as anything is there, b"" once `now_s` has moved on by `timeout_s`.

        Raises LinkLost where the line is gone.
        """
        ...

    def now_s(self) -> float:
        """Return the clock that the host waits by: monotonic, in seconds, virtual where time is simulated."""
        ...

    def close(self) -> None:
        """Give the line back."""
        ...


@dataclass(slots=True, eq=False)
class MergedTlm(Tlm):
    """`frames` consecutive TLM frames without a gap as one message; `counter` is that of the last one."""

    frames: int


@runtime_checkable
class VirtualLine(Protocol):
    """A line to a simulated controller in this process: what needs no frame comes without."""

    @property
    def is_watched(self) -> bool:
        """Whether the controller hears its host while that reads."""
        ...

    def watch(self, *, watched: bool) -> None:
        """Let the controller hear its host, as by heartbeats, while that reads; or no longer."""
        ...

    def samples(self) -> Sequence[MergedTlm]:
        """Return the samples since the last call; the bytes that were read meanwhile do not have them."""
        ...


PATIENCE_S = 20.0
"""Longest wait, by the computer's clock, for one ADVANCE."""
MOST_STILL = 1000
"""So many answers in a row in which no time has passed are those of a clock that stands."""
_REPLY = 0x40
_LEAST_US = 1


class SteppedLine:
    """A line to a simulated controller whose time stands still except while the host waits.

    Every wait becomes an ADVANCE; what the controller sent until then comes back before its reply. So a run over a
    real tty takes no longer than it must, and is the same run every time. Wraps a line after HELLO has said that the
    controller's clock is driven; `session` is that of HELLO.
    """

    live = False

    def __init__(self, line: Transport, session: int) -> None:
        self.name = line.name
        self._line = line
        self._session = session
        self._seq = 0
        self._decoder = FrameDecoder(watch_for_abort=False)
        self._now_s = 0.0
        self._still = 0
        self._failure: LinkLost | None = None

    def write(self, data: bytes) -> None:
        self._line.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Let up to `timeout_s` of controller time pass; everything sent meanwhile, ADVANCE's reply included."""
        return self._advance(max(_LEAST_US, round(timeout_s * 1e6)))

    def now_s(self) -> float:
        """Return controller time; 0 until the first wait has told it."""
        return self._now_s

    def close(self) -> None:
        self._line.close()

    def _advance(self, timeout_us: int) -> bytes:
        if self._failure is not None:
            raise self._failure
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        self._line.write(encode_frame(Advance.ID, seq, self._session, 0, Advance(timeout_us).pack()))
        end_s = self._line.now_s() + PATIENCE_S
        data = b""
        while (left_s := end_s - self._line.now_s()) > 0.0:
            part = self._line.read(left_s)
            data += part
            for frame in self._decoder.feed(part):
                if frame.type_id == Advance.ID | _REPLY and frame.seq == seq:
                    self._note(_time_s(frame, self.name))
                    return data
        raise self._fail(f"did not let time pass within {PATIENCE_S:.0f} s")

    def _note(self, now_s: float) -> None:
        """Take the time of an answer; LinkLost where it stands still for good. A restart sets it back."""
        self._still = self._still + 1 if now_s == self._now_s else 0
        self._now_s = now_s
        if self._still > MOST_STILL:
            raise self._fail(f"lets no time pass in {MOST_STILL} waits")

    def _fail(self, message: str) -> LinkLost:
        self._failure = failures.simulated_controller_fails(name=self.name, message=message)
        return self._failure


def _time_s(reply: Frame, name: str) -> float:
    if reply.flags != Status.OK:
        raise failures.clock_refuses_to_advance(name=name)
    return AdvanceReply.unpack(reply.payload).t_dev_us * 1e-6
