"""A machine on the virtual bench, configured and armed, for tests of the interface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Self

import pytest

from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.interface import (
    Axis,
    ControllerSettings,
    CutRequest,
    MachineEvent,
    MachineListener,
    PulseBlockBatch,
    PulseLog,
    PulseMode,
    PulseSettings,
    PulseTrain,
    ServoLaw,
    TelemetryBlock,
    TelemetrySettings,
)
from edmctl.machine.stop import StopRequest
from edmctl.simulator import BenchConfig, VirtualBench, open_bench

SETTINGS = ControllerSettings(
    piezo_max_v=120.0,
    slew_limit_v_s=1000.0,
    gain_um_per_v=2.967,
    safe_z_um=30.0,
    retract_v_s=337.0,
    sensor_fitted=True,
    servo_law=ServoLaw.RELAY,
    forward_um_s=5.0,
    back_um_s=5.0,
    short_back_um_s=50.0,
    filter_hz=20.0,
    hysteresis=0.02,
    kp_um_s=20.0,
    ki_um_s2=20.0,
    servo_period_us=1000,
    servo_latency=1,
    short_v=6.0,
    arc_v=19.5,
    arc_delay_us=3.0,
    block_pulses=23,
    short_stuck_s=3.0,
    arc_run=60,
    open_lost_um=15.0,
    open_lost_s=10.0,
    watchdog_s=0.25,
    dielectric_required=True,
    flow_min_lpm=0.5,
    temperature_max_c=30.0,
)
PULSES = PulseSettings(130.435, 304.348, 40.0, 0.12, PulseMode.ISOFREQUENCY, 0.0)
TELEMETRY = TelemetrySettings(period_us=10_000, batch=10, pulse_log=PulseLog.BLOCKS)
REFERENCE_V = 0.8 * 12.0


@dataclass(slots=True)
class Heard(MachineListener):
    """A listener that keeps everything."""

    blocks: list[TelemetryBlock] = field(default_factory=list)
    sums: list[PulseBlockBatch] = field(default_factory=list)
    trains: list[PulseTrain] = field(default_factory=list)
    events: list[MachineEvent] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)

    def telemetry(self, block: TelemetryBlock) -> None:
        self.blocks.append(block)

    def pulse_blocks(self, batch: PulseBlockBatch) -> None:
        self.sums.append(batch)

    def pulses(self, batch: PulseTrain) -> None:
        self.trains.append(batch)

    def event(self, event: MachineEvent) -> None:
        self.events.append(event)

    def log(self, level: int, text: str) -> None:
        self.lines.append(text)


class Rig:
    """A bench, a machine on it, and a listener."""

    def __init__(self, *, direct: bool = False) -> None:
        self.bench: VirtualBench = open_bench(BenchConfig(), 1)
        self.session = Session(self.bench.direct_line() if direct else self.bench.transport, Random(1))
        self.session.open()
        self.stop = StopRequest()
        self.machine = LinkMachine(self.session, self.stop)
        self.heard = Heard()

    def ready(self, pulse_log: PulseLog = PulseLog.BLOCKS) -> Self:
        """Configure, start telemetry, arm."""
        self.machine.configure(SETTINGS, PULSES)
        telemetry = TelemetrySettings(TELEMETRY.period_us, TELEMETRY.batch, pulse_log)
        self.machine.start_telemetry(telemetry, self.heard)
        self.machine.arm()
        return self

    def sparking(self, z_limit_um: float = 400.0, max_time_s: float = 1000.0) -> Self:
        """Go over the work, approach, and start a cut."""
        self.machine.move_stage(Axis.X, 0.0, 5000.0)
        self.machine.approach(5.0, 120.0, REFERENCE_V)
        self.machine.start_cut(CutRequest(REFERENCE_V, z_limit_um, max_time_s))
        return self


MakeRig = Callable[[], Rig]


@pytest.fixture
def rig() -> MakeRig:
    """Return a maker of rigs."""
    return Rig
