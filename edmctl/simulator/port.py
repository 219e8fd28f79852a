"""The virtual controller's end of the line: sessions, at-most-once execution, events until acknowledged."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from edmctl.link.frame import Frame, FrameDecoder, encode_frame
from edmctl.link.messages import REQUESTS, Heartbeat, Hello, Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.messages import Event, Fault
    from edmctl.link.wire import Message

REPLY_BIT = 0x40
REPLIES_KEPT = 8
Outcome = tuple[Status, bytes]


class DevicePort:
    """Turns bytes into commands and messages into bytes.

    `execute` gets each valid command of the session once; a repeated frame gets the reply it got before.
    `urgent` tells that somebody waits for what is to be sent; answers to heartbeats may wait for company.
    """

    def __init__(self, execute: Callable[[Message], Outcome]) -> None:
        self._execute = execute
        self._decoder = FrameDecoder()
        self._session = 0
        self._replies: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._out: list[bytes] = []
        self.urgent = False
        self._unacknowledged: list[tuple[int, bytes]] = []
        self._event_no = 0
        self.rx_drop = 0

    @property
    def rx_bad(self) -> int:
        """Frames dropped for a bad check."""
        return self._decoder.bad

    def receive(self, data: bytes) -> tuple[bool, bool]:
        """Execute what the bytes say; returns (a valid frame of the session came, an abort run came)."""
        heard = False
        for frame in self._decoder.feed(data):
            heard = self._handle(frame) or heard
        aborted, self._decoder.abort_seen = self._decoder.abort_seen, False
        return heard, aborted

    def take_output(self) -> bytes:
        """Hand over everything to be sent."""
        out = b"".join(self._out)
        self._out.clear()
        self.urgent = False
        return out

    def send(self, message: Message) -> None:
        """Send an unsolicited message once."""
        self._out.append(encode_frame(message.ID, 0, self._session, 0, message.pack()))

    def next_event_no(self) -> int:
        """Number of the next event; wraps past 65535 and skips 0, which means none."""
        self._event_no = self._event_no % 0xFFFF + 1
        return self._event_no

    def send_event(self, event: Event | Fault) -> None:
        """Send an event and keep it for repetition."""
        frame = encode_frame(event.ID, 0, self._session, 0, event.pack())
        self._unacknowledged.append((event.event_no, frame))
        self._out.append(frame)

    def acknowledge(self, last_event: int) -> None:
        """Forget every event up to and with `last_event`."""
        numbers = [n for n, _ in self._unacknowledged]
        if last_event in numbers:
            del self._unacknowledged[: numbers.index(last_event) + 1]

    def repeat_events(self) -> bool:
        """Send again what is not acknowledged; returns whether there was anything."""
        self._out.extend(frame for _, frame in self._unacknowledged)
        return bool(self._unacknowledged)

    def _handle(self, frame: Frame) -> bool:
        if frame.type_id == Hello.ID and frame.session != 0:
            if frame.session != self._session:
                self._session = frame.session
                self._replies.clear()
                self._unacknowledged.clear()
        elif frame.session != self._session or frame.session == 0:
            self.rx_drop += 1
            return False
        key = (frame.type_id, frame.seq)
        reply = self._replies.get(key)
        if reply is None:
            status, payload = self._run(frame)
            reply = encode_frame(frame.type_id | REPLY_BIT, frame.seq, self._session, status, payload)
            self._replies[key] = reply
            if len(self._replies) > REPLIES_KEPT:
                self._replies.popitem(last=False)
        self._out.append(reply)
        self.urgent = self.urgent or frame.type_id != Heartbeat.ID
        return True

    def _run(self, frame: Frame) -> Outcome:
        message_type = REQUESTS.get(frame.type_id)
        if message_type is None:
            return Status.UNKNOWN_TYPE, b""
        try:
            message = message_type.unpack(frame.payload)
        except ValueError:
            return Status.BAD_LENGTH, b""
        return self._execute(message)
