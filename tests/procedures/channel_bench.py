"""A machine that only scans: it follows lines and sinks towards its limit, and sparks as much as it is told to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from edmctl.errors import PreconditionError
from edmctl.machine.interface import (
    CutRequest,
    EventCode,
    Interlock,
    MachineEvent,
    MachineState,
    MachineStatus,
    ScanLine,
    TelemetryBlock,
    TelemetryFlag,
)
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import Job, JobTally
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import JobRun, JobStateKeeper
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.record.rows import EventRow, NullRecorder, Row
from edmctl.results.progress import Progress
from tests.procedures.conftest import samples

CIRCLE = str(Path(__file__).parents[2] / "profiles" / "channel-circle.toml")
STEP_S = 0.01
PULSES_A_STEP = 23


@dataclass(slots=True)
class ScanningMachine:
    """What a pass needs of a machine.

    `misses_um` says how far above its limit the tool stays at a time; after `quiet_after` lines hardly a pulse
    strikes; after `refuse_after` lines no more are taken, and `then` says what a wait brings.
    """

    place_um: tuple[float, float] = (0.0, 0.0)
    z_um: float = 0.0
    sink_um_s: float = 1e3
    queue_size: int = 16
    current_a: float = 0.01
    open_pulses: int = 5
    quiet_after: int = 1 << 30
    arc_pulses: int = 0
    misses_um: Callable[[float], float] = lambda _: 0.0
    refuse_after: int = 1 << 30
    then: Callable[[], MachineEvent | None] = lambda: None
    time_s: float = 0.0
    watch: Watch | None = None
    moves: list[ScanLine] = field(default_factory=list)
    longest_queue: int = 0
    scans: list[CutRequest] = field(default_factory=list)
    full: int = 0
    stopped: int = 0
    _queue: deque[ScanLine] = field(default_factory=deque)
    _limit_um: float = 0.0
    _over: bool = False

    def start_scan(self, request: CutRequest) -> None:
        self.scans.append(request)
        self._limit_um, self._over = request.z_limit_um, False

    def path_move(self, line: ScanLine) -> bool:
        if len(self.moves) >= self.refuse_after:
            raise PreconditionError("The controller refused PATH_MOVE: BAD_STATE.", code="E8100")
        if len(self._queue) >= self.queue_size:
            self.full += 1
            return False
        self._queue.append(line)
        self.moves.append(line)
        self.longest_queue = max(self.longest_queue, len(self._queue))
        return True

    def stop_cut(self) -> MachineEvent:
        self.stopped += 1
        return self._event(EventCode.STOPPED)

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        if len(self.moves) >= self.refuse_after:
            return self.then()
        rows = [self._step() for _ in range(round(duration_s / STEP_S))]
        if self.watch is not None:
            self.watch.telemetry(self._block(rows))
        return self._event(EventCode.PATH_DONE) if self._over else None

    def status(self) -> MachineStatus:
        return MachineStatus(
            state=MachineState.MACHINING,
            fault=0,
            interlocks=Interlock(0),
            displacement_um=self.z_um,
            x_um=self.place_um[0],
            y_um=self.place_um[1],
            theta_deg=0.0,
            actuator_v=self.z_um / 3.0,
            gap_v=9.6,
            temperature_c=22.0,
            flow_lpm=1.0,
            monitor_v=self.z_um / 3.0,
            flags=TelemetryFlag(0),
        )

    def _step(self) -> tuple[float, float]:
        self.time_s += STEP_S
        if self._queue and not self._over:
            self._follow(self._queue[0])
        reach_um = self._limit_um - self.misses_um(self.time_s)
        self.z_um = min(reach_um, self.z_um + self.sink_um_s * STEP_S)
        return self.time_s, self.z_um

    def _follow(self, move: ScanLine) -> None:
        left = np.array([move.x_um, move.y_um]) - self.place_um
        left_um, way_um = float(np.hypot(*left)), move.speed_um_s * STEP_S
        share = min(1.0, way_um / left_um) if left_um > 0.0 else 1.0
        x_um, y_um = np.array(self.place_um) + share * left
        self.place_um = (float(x_um), float(y_um))
        self._limit_um += share * (move.z_limit_um - self._limit_um)
        if share == 1.0:
            self._queue.popleft()
            self._over = move.last

    def _block(self, rows: list[tuple[float, float]]) -> TelemetryBlock:
        times_s, z_um = np.array(rows).T
        opens = PULSES_A_STEP - 1 if len(self.moves) > self.quiet_after else self.open_pulses
        return samples(
            times_s[0],
            z_um,
            actuator_v=z_um / 3.0,
            gap_v=10.0,
            current_a=self.current_a,
            counts=(opens, PULSES_A_STEP - opens - self.arc_pulses, self.arc_pulses, 0),
        )

    def _event(self, code: EventCode) -> MachineEvent:
        return MachineEvent(code, self.time_s, 0, self.z_um, self.z_um / 3.0)


@dataclass(slots=True)
class Noted(NullRecorder):
    codes: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def append(self, row: Row) -> None:
        if isinstance(row, EventRow):
            self.codes.append(row.code)

    def progress(self, p: Progress) -> None:
        pass

    def note(self, text: str) -> None:
        self.notes.append(text)


def scanning_run(machine: ScanningMachine, *overrides: str) -> tuple[JobRun, Noted]:
    profile = load_profile(CIRCLE, overrides).profile
    job = Job(profile, Setup(), (Place("channel", 0.0, 0.0),))
    noted, ledger = Noted(), JobTally()
    watch = Watch(noted, profile.pulse.duty_voltage_v)
    machine.watch = watch
    return JobRun(machine, job, watch, noted, noted, ledger, JobStateKeeper(job, ledger)), noted  # type: ignore[arg-type]
