"""What the run file costs while a machine works, and how much more it could take.

    python benchmarks/record_cost.py [--minutes 10] [--real 20]

Share of a core: the full log (8 channels at 1 kHz, every pulse at 2.3 kHz, pulse sums, the supervisor's view at
10 Hz, an event a second) is handed over in blocks of 0.1 s, as a machine makes it, with a flush after each half a
second of it and a request to the disk to keep it after each 10 s: as in a real run, with the waiting between them
left out. The CPU seconds of the process are divided by the seconds of data; what making the rows costs is taken
off. The same is done once in real time for --real seconds, through the thread that a job writes with. Bar for both:
5 % of a core.

Sustained: as much of the same log as is made in ten times --minutes, handed over without a pause to the writer that
makes its caller wait; the time runs until the file is closed, compressed and named. Bar: 50 times the real rate.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record.background import SYNC_INTERVAL_S, BackgroundWriter
from edmctl.record.rows import EventLevel, EventRow, NullRecorder, ServoBlock, SlowRow
from edmctl.record.run_meta import RunMeta
from edmctl.record.writer import FLUSH_INTERVAL_S, RunWriter
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.record.rows import Recorder

STEPS = 10
"""Hand-overs in a second, as a telemetry that comes in blocks of 0.1 s has them."""
SERVO_ROWS = 100
PULSES = 230
PULSE_BLOCKS = 10
COST_BAR = 0.05
RATE_BAR = 50.0


class Log:
    """Makes the rows of a run, always new arrays and always the same ones."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(1)
        self._pulse = 0

    def step(self, recorder: Recorder, number: int) -> None:
        """Hand over what a tenth of a second of machining makes."""
        self._blocks(recorder, number / STEPS)
        if number % STEPS == 0:
            args = {"argument": 0, "displacement_um": 120.25, "actuator_v": 61.5}
            recorder.append(EventRow(number / STEPS, 3, EventLevel.DEBUG, "JUMP", args))

    def _blocks(self, recorder: Recorder, start_s: float) -> None:
        random = self._random
        noise = random.standard_normal(SERVO_ROWS)
        time_s = start_s + np.arange(SERVO_ROWS) / (STEPS * SERVO_ROWS)
        small = (3 * noise).astype(np.int8)
        recorder.append(
            ServoBlock(
                time_s, noise, noise + 1, noise + 2, noise + 3, noise + 4, noise + 5, small, small.view("u1")
            )
        )
        recorder.append(SlowRow(start_s, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, 1.0, 1.0, 0.1))
        sums = random.random(PULSE_BLOCKS)
        counts = (23 * sums).astype(np.uint8)
        recorder.append(
            PulseBlockBatch(start_s + sums, counts, counts, counts, counts, 100 * sums, 50 * sums)
        )
        delay_us = random.exponential(20.0, PULSES)
        recorder.append(
            PulseTrain(
                self._pulse,
                self._pulse / 2300,
                1 / 2300,
                (delay_us > 60.0).astype(np.uint8),
                delay_us,
                100.0 - delay_us,
                20.0 + delay_us / 60.0,
            )
        )
        self._pulse += PULSES


def meta() -> RunMeta:
    """A run without a recipe."""
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


def cpu_s(seconds: float, recorder: Recorder, after: Callable[[int], None]) -> float:
    """CPU time of this process for so many seconds of data, with `after` called after each tenth."""
    log = Log()
    before_s = time.process_time()
    for number in range(round(STEPS * seconds)):
        log.step(recorder, number)
        after(number + 1)
    return time.process_time() - before_s


def share(folder: Path, seconds: int) -> tuple[float, int, int]:
    """Share of a core that writing takes, and how often was flushed and synced."""
    # Its own clock stands: it flushes when it is told to.
    writer = RunWriter.create(folder / "share.h5", meta(), lambda: 0.0)
    flush_steps, sync_steps = round(STEPS * FLUSH_INTERVAL_S), round(STEPS * SYNC_INTERVAL_S)
    flushes = syncs = 0

    def after(steps: int) -> None:
        nonlocal flushes, syncs
        if steps % flush_steps == 0:
            writer.flush()
            flushes += 1
        if steps % sync_steps == 0:
            writer.sync()
            syncs += 1

    making_s = cpu_s(seconds, NullRecorder(), lambda _: None)
    cost_s = cpu_s(seconds, writer, after) - making_s
    writer.finish("done", 0)
    return cost_s / seconds, flushes, syncs


def real_share(folder: Path, seconds: int) -> float:
    """Share of a core that writing takes in real time."""

    def paced(recorder: Recorder) -> float:
        start_s = time.monotonic()
        return cpu_s(
            seconds, recorder, lambda steps: time.sleep(max(0.0, start_s + steps / STEPS - time.monotonic()))
        )

    making_s = paced(NullRecorder())
    writer = BackgroundWriter.create(folder / "real.h5", meta())
    cost_s = paced(writer) - making_s
    writer.finish("done", 0)
    return cost_s / seconds


def handing_over_us(folder: Path) -> float:
    """Time that the caller spends on one call of the writer in the background, at a quiet moment."""
    writer = BackgroundWriter.create(folder / "calls.h5", meta())
    row = SlowRow(0.0, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, 1.0, 1.0, 0.1)
    calls = 500
    start = time.perf_counter()
    for _ in range(calls):
        writer.append(row)
    took_s = time.perf_counter() - start
    writer.finish("done", 0)
    return 1e6 * took_s / calls


def sustained(folder: Path, seconds: int) -> tuple[float, float]:
    """Seconds of data that are written per second, and the size of the file in MB."""
    log = Log()
    writer = BackgroundWriter.create(folder / "sustained.h5", meta(), waits=True)
    start = time.perf_counter()
    for number in range(STEPS * seconds):
        log.step(writer, number)
    path = writer.finish("done", 0)
    return seconds / (time.perf_counter() - start), path.stat().st_size / 1e6


def main() -> None:
    """Measure, print, and exit with 1 when a bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=int, default=10)
    parser.add_argument("--real", type=int, default=20)
    args = parser.parse_args()
    seconds = 60 * args.minutes
    with tempfile.TemporaryDirectory() as folder:
        cost, flushes, syncs = share(Path(folder), seconds)
        real = real_share(Path(folder), args.real)
        call_us = handing_over_us(Path(folder))
        rate, size_mb = sustained(Path(folder), 10 * seconds)
    met = max(cost, real) <= COST_BAR and rate >= RATE_BAR
    print(f"data              {seconds} s, {flushes} flushes, {syncs} times kept by the disk")
    print(f"share of a core   {100 * cost:.2f} % (bar {100 * COST_BAR:g} %)")
    print(f"in real time      {100 * real:.2f} % over {args.real} s")
    print(f"handing over      {call_us:.1f} µs a call")
    print(
        f"sustained         {rate:.0f} times the real rate (bar {RATE_BAR:g}), {size_mb:.0f} MB when closed"
    )
    print("ok" if met else "MISSED")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
