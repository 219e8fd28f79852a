"""Time that the run file costs a 900 s virtual run: `python benchmarks/record_write.py`.

Hands over what such a run hands over (90,000 servo samples in 9,000 blocks, 9,000 slow rows, 90,000 pulse
blocks, 2.0 M pulses) and prints the time of the writer alone, on a wall clock.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from edmctl.record.rows import NullRecorder, Recorder, ServoBlock, SlowRow
from edmctl.record.run_meta import RunMeta
from edmctl.record.writer import RunWriter
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain

CALLS = 9000
SERVO_ROWS = 10
PULSES = 222


def meta() -> RunMeta:
    return RunMeta(
        run_id="bench",
        title="benchmark",
        start_time="2025-01-01T00:00:00+00:00",
        command=("benchmark",),
        host="host",
        simulated=True,
        seed=1,
        profile_text="",
        profile_sha256="",
        edmctl_version="0",
    )


def hand_over(recorder: Recorder) -> None:
    """Hand over all the rows of a run."""
    rng = np.random.default_rng(1)
    wave = rng.random(SERVO_ROWS)
    counts = rng.integers(0, 23, SERVO_ROWS)
    pulse_class = rng.integers(0, 4, PULSES).astype(np.uint8)
    pulse = rng.random(PULSES)
    for i in range(CALLS):
        recorder.append(ServoBlock(wave, wave, wave, wave, wave, wave, wave, counts, counts))
        recorder.append(SlowRow(0.1 * i, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, 1.0, 1.0, 0.1))
        recorder.append(PulseBlockBatch(wave, counts, counts, counts, counts, wave, wave))
        first = i * PULSES
        recorder.append(
            PulseTrain(first, first / 2300, 1 / 2300, pulse_class, pulse, pulse, pulse),
        )


def measure(folder: Path) -> str:
    """Write one run file and describe what it cost."""
    start = time.perf_counter()
    hand_over(NullRecorder())
    making_s = time.perf_counter() - start
    start = time.perf_counter()
    writer = RunWriter.create(folder / "run.h5", meta())
    create_s = time.perf_counter() - start
    start = time.perf_counter()
    hand_over(writer)
    append_s = time.perf_counter() - start - making_s
    start = time.perf_counter()
    path = writer.finish("done", 0)
    finish_s = time.perf_counter() - start
    total_s = create_s + append_s + finish_s
    return (
        f"create {create_s:.3f} s, append {append_s:.3f} s, finish {finish_s:.3f} s: {total_s:.3f} s "
        f"(making the rows {making_s:.3f} s, not counted); {path.stat().st_size / 1e6:.1f} MB"
    )


def main() -> None:
    for _ in range(5):
        with tempfile.TemporaryDirectory() as folder:
            print(measure(Path(folder)))


if __name__ == "__main__":
    main()
