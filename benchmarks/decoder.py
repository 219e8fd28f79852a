"""The frame decoder under garbage and damage: what it must never accept, never lose and never miss.

Prints one line a figure with its bar; the exit code is 1 where a bar other than speed is missed.
`python benchmarks/decoder.py [--scale 0.1]` does a tenth of everything.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from random import Random
from typing import TYPE_CHECKING

from edmctl.link.frame import MAX_PAYLOAD, Frame, FrameDecoder, encode_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

GARBAGE_MB, DAMAGED_MB, ABORTS = 200.0, 40.0, 20_000
SPEED_MB_S = 50.0
GROUP = 24  # frames around each batch of damage
READ = 4096  # bytes that a driver hands over at once, at most


class Mutated:
    """A stream of frames with damage, and what of it is still whole.

    Every frame carries its own number, so whatever the decoder accepts can be held against what was sent.
    """

    def __init__(self, megabytes: float, seed: int) -> None:
        random = Random(seed)
        self.sent: list[Frame] = []
        self.clean: set[int] = set()
        self.batches = 0
        parts: list[bytes] = []
        size = 0
        while size < megabytes * 1e6:
            part = self._group(random)
            parts.append(part)
            size += len(part)
        # Whole frames behind the last damage show that the decoder found back.
        parts.append(b"".join(self._frame(random, clean=True) for _ in range(GROUP)))
        self.stream = b"".join(parts)

    def _frame(self, random: Random, *, clean: bool) -> bytes:
        number = len(self.sent)
        payload = number.to_bytes(4, "little") + random.randbytes(random.randrange(MAX_PAYLOAD - 3))
        frame = Frame(random.randrange(256), number & 0xFF, random.randrange(1, 256), 0, payload)
        self.sent.append(frame)
        if clean:
            self.clean.add(number)
        return encode_frame(*frame)

    def _group(self, random: Random) -> bytes:
        """Frames with one batch of damage in them; those that it does not touch count as clean."""
        first = len(self.sent)
        frames = [self._frame(random, clean=False) for _ in range(GROUP)]
        data = b"".join(frames)
        start = random.randrange(1, len(data) - 1)
        touched_end, replacement = damage(random, data, start)
        self.batches += 1
        at = 0
        for number, frame in enumerate(frames, first):
            end = at + len(frame)
            if end <= start or at >= touched_end:
                self.clean.add(number)
            at = end
        return data[:start] + replacement + data[touched_end:]


def damage(random: Random, data: bytes, start: int) -> tuple[int, bytes]:
    """What a line does to data[start:end]: returns that end and the bytes that arrive instead."""
    kind = random.randrange(6)
    if kind == 0:  # one to three bits flipped
        end = min(len(data), start + random.randrange(1, 60))
        flipped = bytearray(data[start:end])
        for _ in range(random.randrange(1, 4)):
            flipped[random.randrange(len(flipped))] ^= 1 << random.randrange(8)
        return end, bytes(flipped)
    if kind == 1:  # a span lost, perhaps across frames
        return min(len(data), start + random.randrange(1, 700)), b""
    if kind == 2:  # a burst of noise
        end = min(len(data), start + random.randrange(1, 40))
        return end, random.randbytes(end - start)
    if kind == 3:  # a span doubled
        end = min(len(data), start + random.randrange(1, 300))
        return end, data[start:end] * 2
    if kind == 4:  # noise between the bytes
        return start, random.randbytes(random.randrange(1, 400))
    end = min(len(data), start + random.randrange(1, 30))  # line held low, too short for an abort
    return end, bytes(random.randrange(1, 6)) + b"\x01"


def pieces(data: bytes, sizes: Iterator[int]) -> Iterator[bytes]:
    """Cut `data` as reads would."""
    at = 0
    while at < len(data):
        size = next(sizes)
        yield data[at : at + size]
        at += size


def timed(decoder: FrameDecoder, parts: Iterable[bytes]) -> tuple[list[Frame], float, int]:
    """Feed `parts`; returns the frames, the seconds inside the decoder and the bytes fed."""
    found: list[Frame] = []
    spent_s, size = 0.0, 0
    for part in parts:
        start_s = time.perf_counter()
        frames = decoder.feed(part)
        spent_s += time.perf_counter() - start_s
        found += frames
        size += len(part)
    return found, spent_s, size


def constant(size: int) -> Iterator[int]:
    """Reads of one size."""
    while True:
        yield size


def between(random: Random, least: int, most: int) -> Iterator[int]:
    """Reads of random sizes."""
    while True:
        yield random.randrange(least, most + 1)


def noise(megabytes: float) -> Iterator[bytes]:
    """Pure garbage in reads of READ bytes."""
    random = Random(200)
    for _ in range(round(megabytes * 1e6 / READ)):
        yield random.randbytes(READ)


def missed_aborts(count: int, stream: bytes) -> int:
    """How many abort runs, sent from as many random states of the decoder, were not seen."""
    random = Random(8)
    missed = 0
    for number in range(count):
        decoder = FrameDecoder()
        at = random.randrange(len(stream) - 600)
        before = random.randbytes(300) if number % 2 else stream[at : at + random.randrange(600)]
        for part in pieces(before, between(random, 1, 300)):
            decoder.feed(part)
        decoder.abort_seen = False
        for part in pieces(bytes(8 + random.randrange(25)), between(random, 1, 33)):
            decoder.feed(part)
        missed += not decoder.abort_seen
    return missed


class Report:
    """Figures with their bars; remembers whether one of them was missed."""

    def __init__(self) -> None:
        self.failed = False

    def zero(self, name: str, value: int) -> None:
        """A figure that must be 0."""
        self.failed = self.failed or value != 0
        print(f"{name:58} {value:10}   bar 0{'' if value == 0 else '   MISSED'}")

    def speed(self, name: str, size: int, spent_s: float) -> None:
        """A speed, printed with its bar."""
        rate = size / 1e6 / spent_s
        print(
            f"{name:58} {rate:10.0f}   bar {SPEED_MB_S:.0f} MB/s{'' if rate >= SPEED_MB_S else '   MISSED'}"
        )


def judge(report: Report, made: Mutated, found: list[Frame], name: str) -> None:
    """Hold what was accepted against what was sent."""
    numbers = [int.from_bytes(frame.payload[:4], "little") for frame in found]
    false = sum(n >= len(made.sent) or frame != made.sent[n] for n, frame in zip(numbers, found, strict=True))
    report.zero(f"{name}: damaged frames accepted", false)
    report.zero(f"{name}: clean frames lost of {len(made.clean)}", len(made.clean - set(numbers)))


def main() -> int:
    """Print the figures; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full amount")
    scale = parser.parse_args().scale
    report = Report()
    # The collector would walk again and again through frames that only this benchmark keeps.
    gc.disable()

    decoder = FrameDecoder()
    found, spent_s, size = timed(decoder, noise(GARBAGE_MB * scale))
    report.zero(f"garbage, {size / 1e6:.0f} MB: frames accepted", len(found))
    report.zero("garbage: aborts seen", int(decoder.abort_seen))
    report.speed("garbage", size, spent_s)

    made = Mutated(DAMAGED_MB * scale, seed=40)
    sizes: dict[str, Callable[[], Iterator[int]]] = {
        f"reads of {READ} bytes": lambda: constant(READ),
        "reads of 1 to 4096 bytes": lambda: between(Random(1), 1, READ),
    }
    first: list[Frame] | None = None
    for name, reads in sizes.items():
        decoder = FrameDecoder()
        found, spent_s, size = timed(decoder, pieces(made.stream, reads()))
        title = (
            f"mutated, {size / 1e6:.0f} MB, {made.batches} batches" if first is None else f"mutated, {name}"
        )
        judge(report, made, found, title)
        report.zero("mutated: spurious aborts", int(decoder.abort_seen))
        report.speed(f"mutated, {name}", size, spent_s)
        if first is None:
            first = found
        report.zero(
            f"frames that differ from those of reads of {READ} bytes",
            sum(a != b for a, b in zip(first, found, strict=False)) + abs(len(first) - len(found)),
        )

    small = made.stream[:1_000_000]
    whole = FrameDecoder().feed(small)
    single, _, _ = timed(FrameDecoder(), pieces(small, constant(1)))
    report.zero("reads of one byte: frames that differ, 1 MB", int(single != whole))

    count = round(ABORTS * scale)
    report.zero(f"abort runs missed of {count}, from random states", missed_aborts(count, made.stream))
    return int(report.failed)


if __name__ == "__main__":
    sys.exit(main())
