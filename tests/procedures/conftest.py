"""A bench, a machine on it and a quick recipe: 12 µm deep at a high current, about 150 s of machine time."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.actuator.identification import Identification, identify
from edmctl.actuator.record import Record
from edmctl.actuator.waveforms import sampled, slow_legs
from edmctl.errors import EdmError, Interrupted
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.interface import MachineState, TelemetryBlock
from edmctl.machine.stop import StopRequest
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import CalibratedActuator, Job, JobState, JobTally, StateStore, job_of, job_state
from edmctl.procedures.machining import run_job
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import JobRun, JobStateKeeper
from edmctl.procedures.session import condition
from edmctl.procedures.settings import controller_settings, pulse_settings, telemetry_settings
from edmctl.profile.setup import Sensor, Setup
from edmctl.record.rows import (
    EventLevel,
    EventRow,
    LinkRow,
    NullRecorder,
    Recorder,
    RejectedTouch,
    Row,
    RunEvent,
    ServoBlock,
    SlowRow,
    TouchRow,
)
from edmctl.results.job import JobResult, SiteResult
from edmctl.results.progress import Phase, Progress
from edmctl.results.telemetry import PulseBlockBatch
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.config import SensorConstants
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.plant import VirtualActuator

CU270 = str(Path(__file__).parents[2] / "profiles" / "cu270.toml")
QUICK = (
    'target={kind="depth",depth_um=12.0,tolerance_um=2.0}',
    'jump.mode="off"',
    "approach.speed_um_s=4.0",
    "measure.settle_s=0.2",
    "measure.touches=2",
    "pulse.current_a=0.5",
    'log.pulses="blocks"',
)


@dataclass(slots=True)
class Seen(NullRecorder):
    servo: list[ServoBlock] = field(default_factory=list)
    pulses: list[PulseBlockBatch] = field(default_factory=list)
    slow: list[SlowRow] = field(default_factory=list)
    events: list[tuple[float, int, EventLevel, str, Mapping[str, float | int | str | bool]]] = field(
        default_factory=list
    )
    touches: list[TouchRow] = field(default_factory=list)
    sites: list[SiteResult] = field(default_factory=list)
    links: list[LinkRow] = field(default_factory=list)

    @property
    def codes(self) -> list[int]:
        return [event[1] for event in self.events]

    def args(self, code: int) -> list[Mapping[str, float | int | str | bool]]:
        return [event[4] for event in self.events if event[1] == code]

    def messages(self, code: int) -> list[str]:
        return [event[3] for event in self.events if event[1] == code]

    def column(self, name: str) -> NDArray[np.float64]:
        return np.concatenate([getattr(block, name) for block in self.servo])

    @property
    def doubts(self) -> list[str]:
        """What was reported of doubted touches."""
        return self.messages(RunEvent.TOUCH_DOUBTED)

    def append(self, row: Row) -> None:
        if isinstance(row, EventRow):
            self.events.append((row.time_s, row.code, row.level, row.message, row.args))
        elif isinstance(row, RejectedTouch):
            (i,) = (i for i, touch in enumerate(self.touches) if touch.time_s == row.time_s)
            self.touches[i] = replace(self.touches[i], accepted=False)
        else:
            kept: dict[type, list[Any]] = {
                ServoBlock: self.servo,
                PulseBlockBatch: self.pulses,
                SlowRow: self.slow,
                TouchRow: self.touches,
                SiteResult: self.sites,
                LinkRow: self.links,
            }
            kept.get(type(row), []).append(row)


def samples(
    start_s: float,
    displacement_um: float | NDArray[np.float64],
    *,
    actuator_v: float | NDArray[np.float64] = 30.0,
    gap_v: float = 9.6,
    current_a: float = 0.02,
    counts: tuple[int, int, int, int] = (0, 23, 0, 0),
    state: MachineState = MachineState.MACHINING,
) -> TelemetryBlock:
    """Samples at 100 Hz, ten unless an array has more, each with so many open, normal, arc and short pulses."""
    n = len(displacement_um) if isinstance(displacement_um, np.ndarray) else 10
    time_s = start_s + 0.01 * np.arange(n, dtype=np.float64)
    z_um, volts, gap, amperes = (
        np.broadcast_to(value, n).astype(np.float64)
        for value in (displacement_um, actuator_v, gap_v, current_a)
    )
    opens, normals, arcs, shorts, states, flags = (np.full(n, one, np.uint8) for one in (*counts, state, 1))
    return TelemetryBlock(
        time_s, z_um, volts, gap, amperes, opens, normals, arcs, shorts, states, flags, missing_frames=0
    )


@dataclass(slots=True)
class Kept:
    """A journal in memory; states travel through plain values, as they do through a file."""

    states: list[JobState] = field(default_factory=list)
    urgent: list[bool] = field(default_factory=list)

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        self.states.append(job_state(state.as_mapping()))
        self.urgent.append(urgent)


@contextmanager
def refused(code: str, match: str | None = None) -> Iterator[pytest.ExceptionInfo[EdmError]]:
    with pytest.raises(EdmError, match=match) as caught:
        yield caught
    assert caught.value.code == code


@dataclass(slots=True)
class Told:
    """An observer that keeps what it is told, and may do something when a phase is first seen."""

    notes: list[str] = field(default_factory=list)
    states: list[Progress] = field(default_factory=list)
    when: dict[Phase, Callable[[], None]] = field(default_factory=dict)

    def progress(self, p: Progress) -> None:
        self.states.append(p)
        if p.phase in self.when:
            self.when.pop(p.phase)()

    def note(self, text: str) -> None:
        self.notes.append(text)


def eroding(config: BenchConfig, wear: float, removal: float = 1.0) -> BenchConfig:
    """A bench whose tool wears so many times as much per volume of work, and whose work erodes so much faster."""
    work, tool = removal * config.work_removal, wear * removal * config.tool_wear
    return replace(config, work_removal=work, tool_wear=tool)


class Shop:
    """One virtual bench with everything a job needs; `changed` makes it another one than the recipe thinks of."""

    def __init__(
        self,
        overrides: Sequence[str] = (),
        seed: int = 1,
        calibration: CalibratedActuator | None = None,
        *,
        sensor: bool = True,
        direct: bool = False,
        changed: Callable[[BenchConfig], BenchConfig] = lambda config: config,
    ) -> None:
        loaded = load_profile(CU270, (*QUICK, *overrides))
        self.profile = loaded.profile
        config = BenchConfig(
            tool_diameter_um=self.profile.tool.diameter_um,
            offset_um=self.profile.approach.offset_um,
            sensors=SensorConstants(fitted=sensor),
        )
        self.bench: VirtualBench = open_bench(changed(config), seed)
        line = self.bench.direct_line() if direct else self.bench.transport
        self.session = Session(line, Random(1))
        self.session.open()
        self.stop = StopRequest()
        self.machine = LinkMachine(self.session, self.stop)
        self.job: Job = job_of(self.profile, Setup(sensor=Sensor(fitted=sensor)), loaded.places, calibration)
        self.seen = Seen()
        self.told = Told()
        self.tally = JobTally()

    def run_job(self, recorder: Recorder | None = None, journal: StateStore | None = None) -> JobResult:
        return run_job(
            self.machine,
            self.job,
            recorder=recorder or self.seen,
            observer=self.told,
            tally=self.tally,
            store=journal,
        )

    def inject(self, fault: str) -> None:
        """Let something go wrong, by the words of `--inject`."""
        self.bench.inject(parse_injection(fault))

    def stop_when(self, when: Callable[[Progress], bool], number: int = signal.SIGINT) -> None:
        """Ask for the end of the job at the first state of a cut that `when` picks."""

        def look() -> None:
            if when(self.told.states[-1]):
                self.stop.request(number)
            else:
                self.told.when[Phase.MACHINING] = look

        self.told.when[Phase.MACHINING] = look

    def left(self, when: Callable[[Progress], bool]) -> JobState:
        """Stop the job at the first state of a cut that `when` picks; what its journal keeps."""
        self.stop_when(when)
        kept = Kept()
        with pytest.raises(Interrupted):
            self.run_job(journal=kept)
        return kept.states[-1]

    def taken_up(self, state: JobState, pause_s: float = 0.0) -> Shop:
        """The same bench and another process, which resumes the job."""
        after = copy(self)
        after.seen, after.told, after.tally, after.stop = Seen(), Told(), JobTally(), StopRequest()
        after.machine = LinkMachine(self.session, after.stop)
        after.job = replace(self.job, resumed=state, pause_s=pause_s)
        return after

    def true_depth_um(self, site: SiteResult) -> float:
        """The depth of the hole nearest to a site."""
        holes = self.bench.truth()
        return min(holes, key=lambda h: math.hypot(h.x_um - site.x_um, h.y_um - site.y_um)).depth_um

    def holds(self, site: SiteResult, below_um: float = math.inf) -> bool:
        """Whether the interval of a depth holds the truth, and half of it is below a bound."""
        return abs(self.true_depth_um(site) - site.depth_um) <= site.depth_u95_um < below_um

    def holds_wear(self, site: SiteResult, below_um: float = math.inf) -> bool:
        """The same of the wear of a tool that has made one hole."""
        return abs(self.bench.tool_wear_um - site.wear_um) <= site.wear_u95_um < below_um

    def run(self) -> JobRun:
        """What single procedures take, on a machine that nobody has configured."""
        watch = Watch(self.seen, self.profile.pulse.duty_voltage_v)
        journal = JobStateKeeper(self.job, self.tally)
        return JobRun(self.machine, self.job, watch, self.seen, self.told, self.tally, journal)


def armed(shop: Shop, *, conditioned: bool = False) -> JobRun:
    run = shop.run()
    settings = controller_settings(shop.profile, shop.job.setup)
    shop.machine.configure(settings, pulse_settings(shop.profile))
    shop.machine.start_telemetry(telemetry_settings(shop.profile, shop.job.setup), run.watch)
    shop.machine.arm()
    if conditioned:
        condition(run)
    return run


@lru_cache
def identified(seed: int) -> Identification:
    """The actuator of a seed, identified at 50 Hz from the slow legs of a calibration, which are soon fitted."""
    waveform = sampled(slow_legs(150.0), 1000.0)
    driven = VirtualActuator(seed).drive(waveform.u_v)
    thin = slice(None, None, 20)
    record = Record(waveform.t_s[thin], driven.applied_v[thin], driven.sensor_um[thin])
    return identify([record], delay_s=0.0, folds=2, resamples=1)


def calibrated(seed: int = 1) -> CalibratedActuator:
    found = identified(seed)
    return CalibratedActuator(found.model, found.held_out.rms_um)


@dataclass(frozen=True, slots=True)
class Done:
    shop: Shop
    result: JobResult


@pytest.fixture(scope="session")
def done() -> Done:
    shop = Shop()
    return Done(shop, shop.run_job())
