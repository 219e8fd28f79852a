"""A rig for tests of the virtual machine: a bench, a session on it, and short words for what tests do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from random import Random
from typing import Self

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.link import messages as m
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, VirtualBench, open_bench

DUTY_V = 12.0


class Rig:
    """One bench with an open session; events, faults and telemetry frames are kept as they come."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        self.bench: VirtualBench = open_bench(config, seed)
        self.session = Session(self.bench.transport, Random(1))
        self.events: list[m.Event] = []
        self.faults: list[m.Fault] = []
        self.samples: list[m.Tlm] = []
        self.pulses: list[m.Pulses] = []
        self.blocks: list[m.PulseBlocks] = []
        self.session.subscribe(m.Event, self.events.append)
        self.session.subscribe(m.Fault, self.faults.append)
        self.session.subscribe(m.Tlm, self.samples.append)
        self.session.subscribe(m.Pulses, self.pulses.append)
        self.session.subscribe(m.PulseBlocks, self.blocks.append)
        self.session.open()

    def arm(self, params: Mapping[str, float] | None = None) -> Self:
        """Upload parameters, set 2.3 kHz / 30 % / 40 V / 0.12 A, arm, permit pulses, go to the pad."""
        values = dict(params or {})
        for name, value in values.items():
            p = m.PARAMS[name]
            self.session.request(m.SetParam(p.id, round(value / p.scale)))
        crc = m.param_crc(values)
        self.session.request(m.CommitProfile(crc))
        self.session.request(m.PulseConfig(130.435, 304.348, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
        self.session.request(m.Arm(crc))
        self.session.request(m.PulseEnable(1))
        return self

    def to_pad(self) -> Self:
        """Drive the x axis from the parking place over the work."""
        self.session.request(m.StageMove(m.Axis.X, 0, 5_000_000))
        self.wait(m.EventCode.STAGE_DONE, 10.0)
        return self

    def wait(self, code: m.EventCode, timeout_s: float) -> m.Event:
        """Pump until an event of this code, or a fault, has come."""
        seen = len(self.events)

        def done() -> bool:
            return bool(self.faults) or any(e.code == code for e in self.events[seen:])

        assert self.session.pump_until(done, timeout_s), f"no {code.name} within {timeout_s} s"
        assert not self.faults, f"fault {self.faults[0].code}"
        return next(e for e in self.events[seen:] if e.code == code)

    def wait_fault(self, timeout_s: float) -> m.Fault:
        """Pump until a fault has come."""
        assert self.session.pump_until(lambda: bool(self.faults), timeout_s), "no fault"
        return self.faults[0]

    def start_sparking(self, z_limit_um: float = 500.0, max_time_s: float = 3000.0) -> Self:
        """Approach at 2 µm/s and start the servo at 0.8."""
        self.session.request(m.Approach(2.0, 120.0, 0.9 * DUTY_V))
        self.wait(m.EventCode.APPROACH_DONE, 100.0)
        self.session.request(m.ServoStart(0.8 * DUTY_V, z_limit_um, max_time_s))
        return self

    def column(self, name: str) -> NDArray[np.float64]:
        """One column of all telemetry so far, in physical units."""
        data = np.frombuffer(b"".join(t.records for t in self.samples), m.Tlm.record_dtype())
        return np.asarray(data[name] * m.Tlm.record_scales()[name], dtype=np.float64)


RigMaker = Callable[..., Rig]


@pytest.fixture
def rig() -> RigMaker:
    """Return a maker of rigs: `rig(config=BenchConfig(), seed=1)`."""

    def make(config: BenchConfig | None = None, seed: int = 1) -> Rig:
        return Rig(config or BenchConfig(), seed)

    return make
