"""The virtual machine's kernel: its speed beside that of another checkout, and the sessions of the golden digests.

    python benchmarks/kernel.py OTHER [--repeat 5]

Both run by turns in processes of their own. Speed is CPU time a tick (1 ms of the machine), the least of all
repeats: held without pulses, and cutting at 2.3 kHz and 50 kHz, on a machine that is drawn as a profile's default
draws it. The exit code is 1 where this checkout takes more than 1.05 times as long. What the kernel says is compared
by `tests/simulator/test_golden_core.py`: digests of every byte on the line, in sessions with touches, cuts, jumps, a
scan and every fault that can be injected.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection

    from edmctl.link.wire import Request
    from edmctl.simulator import BenchConfig, VirtualBench

WAYS = {"held": None, "cut at 2.3 kHz": 2300.0, "cut at 50 kHz": 50_000.0}
TICKS = {"held": 40_000, "cut at 2.3 kHz": 30_000, "cut at 50 kHz": 10_000}
STEP_TICKS = 200
MOST_SHARE = 1.05
DUTY_V = 12.0


def bench_at(frequency_hz: float | None) -> VirtualBench:
    """A bench that holds its tool, or cuts at that frequency."""
    from dataclasses import replace

    from edmctl.link import messages as m
    from edmctl.link.session import Session
    from edmctl.profile.model import SimSettings
    from edmctl.simulator import BenchConfig, open_bench

    config = BenchConfig(offset_um=5.0)
    if hasattr(config, "spread"):  # checkouts before decision 0042 draw nothing
        config = replace(config, spread=SimSettings().spread)
    bench = open_bench(config, 1)
    controller = bench.controller
    session, crc = Session(bench.transport, Random(1)), m.param_crc({})
    session.open()
    period_us = 1e6 / (frequency_hz or 2300.0)
    pulses = m.PulseConfig(0.3 * period_us, 0.7 * period_us, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0)
    move = m.StageMove(m.Axis.X, 0, 50_000_000)
    message: Request[Any]
    for message in (m.CommitProfile(crc), pulses, m.Arm(crc), m.PulseEnable(1), move):
        session.request(message)
        session.pump(0.24)
    if frequency_hz:
        session.request(m.Approach(1.0, 100.0, 0.9 * DUTY_V))
        while controller.state is m.State.APPROACH:
            session.pump(0.1)
        session.request(m.ServoStart(0.8 * DUTY_V, 500.0, 1e5))
    return bench


def tick_us(way: str) -> float:
    """CPU microseconds a tick."""
    controller = bench_at(WAYS[way]).controller
    controller.advance(STEP_TICKS)
    first, start_s = controller.tick, time.thread_time()
    for _ in range(TICKS[way] // STEP_TICKS):
        controller.host_heard()
        controller.advance(STEP_TICKS)
    return (time.thread_time() - start_s) / (controller.tick - first) * 1e6


class Listener:
    """A session on a bench that goes on whatever happens, and the digest of all that it hears."""

    def __init__(self, config: BenchConfig, seed: int, fault: str = "") -> None:
        from edmctl.link import messages as m
        from edmctl.link.session import Session
        from edmctl.simulator import open_bench
        from edmctl.simulator.injection import parse_injection

        self._bench = open_bench(config, seed)
        if fault:
            self._bench.inject(parse_injection(fault))
        self._heard = hashlib.sha256()
        self._read = self._bench.transport.read
        self._bench.transport.read = self._listen  # type: ignore[method-assign]
        self._session = Session(self._bench.transport, Random(1))
        self._codes: list[m.EventCode] = []
        self._faults: list[m.Fault] = []
        self._session.subscribe(m.Event, lambda event: self._codes.append(m.EventCode(event.code)))
        self._session.subscribe(m.Fault, self._faults.append)
        self._session.open()

    def _listen(self, timeout_s: float) -> bytes:
        data = self._read(timeout_s)
        self._heard.update(data)
        return data

    def ask(self, message: Request[Any]) -> None:
        """Request something; a refusal is an answer too."""
        from edmctl.errors import EdmError

        try:
            self._session.request(message)
        except EdmError as error:
            self._heard.update(type(error).__name__.encode())

    def pump(self, duration_s: float) -> None:
        """Let time pass."""
        from edmctl.errors import EdmError

        try:
            self._session.pump(duration_s)
        except EdmError as error:
            self._heard.update(type(error).__name__.encode())

    def wait(self, timeout_s: float) -> None:
        """Let time pass until the next event or a fault."""
        from edmctl.errors import EdmError

        seen = len(self._codes)
        try:
            self._session.pump_until(lambda: len(self._codes) > seen or bool(self._faults), timeout_s)
        except EdmError as error:
            self._heard.update(type(error).__name__.encode())

    def digest(self) -> str:
        """What was heard, and what only the plant knows."""
        self._heard.update(repr(self._bench.truth()).encode())
        for array in self._bench.truth_map():
            self._heard.update(array.tobytes())
        self._heard.update(repr(float(self._bench.tool_wear_um)).encode())
        return self._heard.hexdigest()


def session_digest(
    config: BenchConfig,
    seed: int,
    *,
    params: dict[str, float] | None = None,
    period_us: float = 434.783,
    full: bool = True,
    fault: str = "",
    cut_s: float = 4.0,
) -> str:
    """Digest of a session with a touch-off, cuts, jumps and a scan."""
    from edmctl.link import messages as m

    host, values = Listener(config, seed, fault), params or {}
    for name, value in values.items():
        host.ask(m.SetParam(m.PARAMS[name].id, round(value / m.PARAMS[name].scale)))
    crc = m.param_crc(values)
    message: Request[Any]
    for message in (
        m.CommitProfile(crc),
        m.PulseConfig(0.3 * period_us, 0.7 * period_us, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0),
        m.Arm(crc),
        m.PulseEnable(1),
        m.TlmStart(1000 if full else 7000, 10, m.PulseLog.FULL if full else m.PulseLog.BLOCKS),
    ):
        host.ask(message)
    for message, most_s in (
        (m.SelfTest(), 2.0),
        (m.StageMove(m.Axis.X, 0, 5_000_000), 5.0),
        (m.TouchOff(40.0, 10.0, 8.0, 90.0, 5.0, 0.1, 3), 8.0),
        (m.PiezoSet(0.0, 100.0), 5.0),
        (m.Approach(5.0, 120.0, 0.9 * DUTY_V), 40.0),
    ):
        host.ask(message)
        host.wait(most_s)
        host.pump(4.0 if isinstance(message, m.TouchOff) else 0.05)
    host.ask(m.ServoStart(0.8 * DUTY_V, 500.0, 1000.0))
    host.pump(cut_s / 2.0)
    host.ask(m.Jump(30.0, 2000.0, 0.05, 3.0))
    host.pump(cut_s / 2.0)
    host.ask(m.ServoStop())
    host.ask(m.ScanStart(0.8 * DUTY_V, 40.0, 100.0))
    for x_um, y_um, last in (
        (20.0, 10.0, 0),
        (20.0, 10.0, 0),
        (20.02, 10.0, 0),
        (50.0, -5.0, 0),
        (0.0, 0.0, 1),
    ):
        host.ask(m.PathMove(x_um, y_um, 40.0, 30.0, last))
    host.pump(3.0)
    for message in (m.ServoStop(), m.GetStatus(), m.BlackboxRead(500), m.WaveformRead(700), m.Disarm()):
        host.ask(message)
    host.pump(1.0)
    return host.digest()


def sessions() -> dict[str, tuple[BenchConfig, int, dict[str, Any]]]:
    """Machine, seed and options of each session, by what is special in it."""
    from edmctl.simulator import BenchConfig, SensorConstants
    from edmctl.simulator.injection import INJECTIONS

    near = BenchConfig(offset_um=20.0)
    foil = BenchConfig(offset_um=20.0, thickness_um=6.0, tool_diameter_um=100.0, tip_rounding_um=3.0)
    blind = BenchConfig(offset_um=20.0, sensors=SensorConstants(fitted=False))
    return {
        **{f"seed {seed}": (near, seed, {}) for seed in (1, 2, 3)},
        "blocks": (near, 4, {"full": False}),
        "50 kHz": (near, 5, {"period_us": 20.0, "full": False, "cut_s": 1.0}),
        "200 Hz": (near, 6, {"period_us": 5000.0}),
        "PI servo": (near, 7, {"params": {"servo_law": 1.0, "kp_um_s": 50.0, "ki_um_s2": 100.0}}),
        "slow servo": (near, 8, {"params": {"servo_latency": 3.0, "servo_period_us": 5000.0}}),
        "no sensor": (blind, 9, {"params": {"sensor_fitted": 0.0}}),
        "foil": (foil, 10, {"cut_s": 40.0}),
        "deep": (near, 11, {"cut_s": 120.0, "full": False}),
        **{name: (near, 12, {"fault": name}) for name in INJECTIONS},
    }


def digests(names: Collection[str] = ()) -> dict[str, str]:
    """Digests of these sessions, or of all."""
    return {
        name: session_digest(config, seed, **rest)
        for name, (config, seed, rest) in sessions().items()
        if not names or name in names
    }


def speed_of(root: Path) -> dict[str, float]:
    """Speed of a checkout, measured by this script in a process of its own."""
    command = [sys.executable, str(Path(__file__).resolve()), str(root), "--measure"]
    told = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(root)}
    )
    return dict(json.loads(told.stdout))


def main() -> int:
    """Measure and print; the exit code is 1 where this checkout is slower."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("other", type=Path, help="root of the other checkout")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        sys.path.insert(0, str(arguments.other))
        print(json.dumps({way: tick_us(way) for way in WAYS}))
        return 0
    roots = (Path(__file__).resolve().parents[1], arguments.other.resolve())
    for root in roots:
        speed_of(root)  # builds its library
    runs = [[speed_of(root) for root in roots] for _ in range(arguments.repeat)]
    slower = False
    for way in WAYS:
        here, there = (min(run[side][way] for run in runs) for side in (0, 1))
        slower |= here > MOST_SHARE * there
        print(f"{way:15} {here:6.3f} µs a tick, other {there:6.3f}: {here / there:5.2f} times")
    return int(slower)


if __name__ == "__main__":
    sys.exit(main())
