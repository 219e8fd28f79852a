"""Compare the image under emulation with the same core on the host, and the images of both compilers, byte for byte.

    python benchmarks/board_twin.py [--seconds 60] [--seed 2]

The image cuts at 2.3 kHz for so long, of the machine's time. A float build of the core is driven beside it,
millisecond by millisecond, with the readings that the board's half has measured and the bytes that have come over
the line: all that both send has to be equal. So it is with the images made by zig and by GCC over the same plant.
Ends with 1 where a byte differs.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.common import options
from edmctl.board.board_build import COMPILERS
from edmctl.link import messages as m
from tests.firmware import board_twin

if TYPE_CHECKING:
    from tests.firmware.board_twin import Cut


def first_difference(one: bytes, other: bytes) -> str:
    """Say where two series of bytes differ; nothing where they do not."""
    if one == other:
        return ""
    at = next(
        (i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other))
    )
    return f"they differ from byte {at} on: {one[at : at + 16].hex()} and {other[at : at + 16].hex()}"


def told(name: str, cut: Cut, seconds: float) -> None:
    """Print what was cut."""
    print(
        f"{name}: {cut.bench.controller.tick * 1e-3:.1f} s, of these {seconds:g} s of cutting, "
        f"{cut.bench.plant.state.depth_um:.2f} µm deep, {cut.pulses} pulses, {len(cut.uart)} bytes sent "
        f"({cut.cpu_s:.1f} s of CPU)",
        flush=True,
    )


def main() -> int:
    """Compare; 1 where a byte differs."""
    given = options(__doc__, seconds=60.0, seed=2)
    failed = False
    cuts: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        library = board_twin.built(Path(folder))
        for name in COMPILERS:
            start_s = time.process_time()
            cut = cuts[name] = board_twin.cut(given.seconds, given.seed, name, library)
            cut.cpu_s = time.process_time() - start_s
            told(name, cut, given.seconds)
            failed = failed or cut.bench.controller.state is not m.State.MACHINING
            difference = first_difference(cut.uart, cut.twin_sent)
            failed = failed or bool(difference)
            print(f"  the core on the host, {cut.twin_ticks} ms beside it: {difference or 'all bytes equal'}")
    one, other = (cuts[name] for name in COMPILERS)
    for what, difference in (
        ("sent by the boards", first_difference(one.uart, other.uart)),
        ("sent by the hosts", first_difference(one.line, other.line)),
    ):
        failed = failed or bool(difference)
        print(f"{' and '.join(COMPILERS)}, bytes {what}: {difference or 'all equal'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
