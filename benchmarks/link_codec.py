"""Cost of the link in Python: `python benchmarks/link_codec.py`.

Prints microseconds per message and frame, megabytes of noise per second through the decoder, and the cost of
a heartbeat with its reply, which a simulated run pays twenty times per second of machining.
"""

from __future__ import annotations

import random
import time
from typing import TYPE_CHECKING

from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.messages import (
    PROTO_MAJOR,
    PROTO_MINOR,
    SCHEMA_HASH,
    Heartbeat,
    HeartbeatReply,
    Hello,
    HelloReply,
    PiezoSet,
    Tlm,
)
from edmctl.link.session import Session

if TYPE_CHECKING:
    from collections.abc import Callable

HELLO = HelloReply(
    PROTO_MAJOR, PROTO_MINOR, 0, SCHEMA_HASH, 0, 0, 0, 0, "", 0, 1000, 1000, 1, 1, 0, 0, 1, 0, 0
)


class Echo:
    """A line whose far end only opens sessions and answers heartbeats, in virtual time."""

    def __init__(self) -> None:
        self.name = "echo"
        self.live = False
        self._clock_s = 0.0
        self._decoder = FrameDecoder()
        self._out = b""

    def now_s(self) -> float:
        return self._clock_s

    def write(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            if frame.type_id == Hello.ID:
                payload = HELLO.pack()[:2] + frame.payload[2:6] + HELLO.pack()[6:]
            else:
                t_host_us = Heartbeat.unpack(frame.payload).t_host_us
                payload = HeartbeatReply(t_host_us, int(self._clock_s * 1e6), 1, 0, 0, 0).pack()
            self._out += encode_frame(frame.type_id | 0x40, frame.seq, frame.session, 0, payload)

    def read(self, timeout_s: float) -> bytes:
        if not self._out:
            self._clock_s += timeout_s
        data, self._out = self._out, b""
        return data

    def close(self) -> None:
        pass


def cost_us(action: Callable[[], object], times: int = 50_000) -> float:
    """Return the best of three averages, in microseconds."""
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        for _ in range(times):
            action()
        best = min(best, time.perf_counter() - start)
    return 1e6 * best / times


def noise_mb_per_s(noise: bytes, times: int) -> float:
    """Return megabytes per second through the decoder."""
    decoder = FrameDecoder()
    return len(noise) / cost_us(lambda: decoder.feed(noise), times)


def heartbeat_us(duration_s: float = 300.0) -> float:
    """Return the cost of one heartbeat with its reply and the two reads between, both ends together."""
    session = Session(Echo(), random.Random(1))
    session.open()
    start = time.perf_counter()
    session.pump(duration_s)
    return 1e6 * (time.perf_counter() - start) / session.statistics.heartbeats_sent


def main() -> None:
    """Print the table."""
    piezo, samples = PiezoSet(60.0, 337.0), Tlm(0, 0, 1000, 14, 0, bytes(range(224)))
    small = encode_frame(PiezoSet.ID, 1, 2, 0, piezo.pack())
    large = encode_frame(Tlm.ID, 1, 2, 0, samples.pack())
    decoder = FrameDecoder()
    rows = [
        ("pack a small message", cost_us(piezo.pack), "us"),
        ("unpack it", cost_us(lambda: PiezoSet.unpack(piezo.pack())) - cost_us(piezo.pack), "us"),
        ("encode its frame", cost_us(lambda: encode_frame(PiezoSet.ID, 1, 2, 0, b"123456")), "us"),
        ("decode it, alone", cost_us(lambda: decoder.feed(small)), "us"),
        ("decode it, one of 1000", cost_us(lambda: decoder.feed(small * 1000), 20) / 1000, "us"),
        ("decode 14 samples, one of 1000", cost_us(lambda: decoder.feed(large * 1000), 20) / 1000, "us"),
        ("heartbeat and reply, both ends", heartbeat_us(), "us"),
        ("random noise", noise_mb_per_s(random.Random(1).randbytes(1 << 20), 10), "MB/s"),
        ("noise without zeros", noise_mb_per_s(bytes(range(1, 256)) * 4000, 10), "MB/s"),
    ]
    for name, value, unit in rows:
        print(f"{name:32} {value:8.2f} {unit}")


if __name__ == "__main__":
    main()
