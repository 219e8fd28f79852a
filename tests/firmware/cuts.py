"""A bench in the middle of a cut, driven by frames alone, so that any controller can be behind it."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random

from edmctl.link import messages as m
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, VirtualBench, open_bench

DUTY_V = 12.0
OFFSET_UM = 3.0


def cut(
    controller: str,
    seconds: float,
    frequency_hz: float = 2300.0,
    seed: int = 2,
    heard: bytearray | None = None,
    *,
    told: bool = True,
) -> VirtualBench:
    """Set up a bench, approach, then cut for so long; as `cut_on` does."""
    bench = open_bench(BenchConfig(offset_um=OFFSET_UM, controller=controller), seed)
    cut_on(bench, seconds, frequency_hz, heard, told=told)
    return bench


def cut_on(
    bench: VirtualBench,
    seconds: float,
    frequency_hz: float = 2300.0,
    heard: bytearray | None = None,
    *,
    told: bool = True,
    settings: Mapping[str, float] | None = None,
) -> Session:
    """Approach, then cut for so long; what came over the line is added to `heard`, with telemetry if `told`."""
    read = bench.transport.read

    def listen(timeout_s: float) -> bytes:
        data = read(timeout_s)
        if heard is not None:
            heard.extend(data)
        return data

    bench.transport.read = listen  # type: ignore[method-assign]
    session = Session(bench.transport, Random(1))
    session.open()
    for name, value in (settings or {}).items():
        session.request(m.SetParam(m.PARAMS[name].id, m.PARAMS[name].to_wire(value)))
    crc = m.param_crc(settings or {})
    period_us = 1e6 / frequency_hz
    on_us = round(0.3 * period_us, 3)
    generator = m.PulseConfig(
        on_us, round(period_us - on_us, 3), DUTY_V / 0.3, 0.12, m.PulseMode.ISOFREQUENCY, 0.0
    )
    for request in (m.CommitProfile(crc), generator, m.Arm(crc), m.PulseEnable(1)):
        session.request(request)
    session.request(m.StageMove(m.Axis.X, 0, 10_000_000))
    session.pump(0.3)
    for _ in range(20):  # a board's stages take their time
        if session.request(m.GetStatus()).state != m.State.MOVING:
            break
        session.pump(0.1)
    if told:
        session.request(m.TlmStart(1000, 14, m.PulseLog.BLOCKS))
    session.request(m.Approach(5.0, 100.0, 0.9 * DUTY_V))
    for _ in range(100):
        session.pump(0.1)
        if session.request(m.GetStatus()).state != m.State.APPROACH:
            break
    session.request(m.ServoStart(0.8 * DUTY_V, 500.0, 1e5))
    session.pump(seconds)
    return session
