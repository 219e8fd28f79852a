"""Cut under the core in double and in float over many seeds; compare depth, duty and counts of pulses.

    python benchmarks/firmware_float.py [--seeds 10] [--seconds 30] [--hz 2300 50000] [--most 0.5]

Single sparks may come out otherwise; the means over all seeds have to agree within `--most` percent.
Duty is the share of the milliseconds' mean gap voltage in that of an open gap. Ends with 1 where they do not.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.common import options
from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder
from edmctl.simulator.config import FIRMWARE, FIRMWARE_FLOAT
from tests.firmware.cuts import DUTY_V, cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

RECORD = np.dtype(
    [(name, {"i32": "<i4", "u16": "<u2", "u8": "u1"}[kind]) for name, kind, _ in m.Tlm.RECORD], align=False
)
CLASSES = ("n_normal", "n_arc", "n_short", "n_open")
FIGURES = ("depth_um", "duty", *CLASSES, "pulses")


def measured(controller: str, seed: int, seconds: float, hz: float) -> NDArray[np.float64]:
    """Cut once, and return the figures."""
    heard = bytearray()
    bench = cut(controller, seconds, hz, seed=seed, heard=heard)
    assert bench.controller.state is m.State.MACHINING
    frames = FrameDecoder(watch_for_abort=False).feed(bytes(heard))
    records = b"".join(m.Tlm.unpack(frame.payload).records for frame in frames if frame.type_id == m.Tlm.ID)
    samples = np.frombuffer(records, RECORD)
    samples = samples[samples["state"] == m.State.MACHINING]
    counts = [float(samples[name].sum()) for name in CLASSES]
    duty = float(samples["gap_v"].mean()) * 0.005 / DUTY_V
    return np.array([bench.plant.state.depth_um, duty, *counts, sum(counts)])


def compared(hz: float, seeds: int, seconds: float) -> float:
    """Print the figures at one frequency; the worst difference of those that are judged, %."""
    numbers = range(1, seeds + 1)
    exact, board = (
        np.array([measured(kind, seed, seconds, hz) for seed in numbers])
        for kind in (FIRMWARE, FIRMWARE_FLOAT)
    )
    worst = 0.0
    for at, name in enumerate(FIGURES):
        mean, other = exact[:, at].mean(), board[:, at].mean()
        apart = 100.0 * (other - mean) / max(mean, 1e-9)
        spread = 100.0 * (board[:, at] - exact[:, at]).std(ddof=1) / seeds**0.5 / max(mean, 1e-9)
        print(f"{name}: double {mean:.5g}, float {other:.5g}: {apart:+.2f} %, standard error {spread:.2f} %")
        if name in ("depth_um", "duty", "n_normal", "pulses"):
            worst = max(worst, abs(apart))
    print(f"{seeds} cuts of {seconds:g} s at {hz:g} Hz: depth, duty, sparks and pulses within {worst:.2f} %")
    return worst


def main() -> int:
    """Compare; 1 where float is further away than it may be."""
    given = options(__doc__, seeds=10, seconds=30.0, hz=[2300.0, 50_000.0], most=0.5)
    worst = max([compared(hz, given.seeds, given.seconds) for hz in given.hz])
    return 1 if worst > given.most else 0


if __name__ == "__main__":
    sys.exit(main())
