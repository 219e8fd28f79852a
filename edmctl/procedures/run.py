"""What every procedure of a run works with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.procedures.monitoring.drift import uncertainty_now
from edmctl.procedures.settings import gap_reference_v
from edmctl.record.rows import EventLevel, EventRow
from edmctl.results.progress import Extremes, Observer, Phase, Progress
from edmctl.results.telemetry import PulseShares

if TYPE_CHECKING:
    from edmctl.forecasts.measuring_stops import Displacement
    from edmctl.machine.interface import Machine
    from edmctl.procedures.event_codes import RunEvent
    from edmctl.procedures.job import Job
    from edmctl.procedures.job_state import JobTally
    from edmctl.procedures.monitoring.watch import Watch
    from edmctl.procedures.state_keeper import JobStateKeeper
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup
    from edmctl.record.rows import Recorder

Args = Mapping[str, float | int | str | bool]

NO_PULSES = PulseShares(0.0, 0.0, 0.0, 0.0)
NOT_SAMPLED = Extremes(math.nan, math.nan, math.nan, math.nan, math.nan)
LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class JobRun:
    """The machine, the job, and everybody who is told about it."""

    machine: Machine
    job: Job
    watch: Watch
    recorder: Recorder
    observer: Observer
    tally: JobTally
    keeper: JobStateKeeper

    @property
    def profile(self) -> Profile:
        """The recipe."""
        return self.job.profile

    @property
    def setup(self) -> Setup:
        """The machine's own settings."""
        return self.job.setup

    @property
    def uncertainty(self) -> Displacement:
        """Standard uncertainties of a displacement as they are by now."""
        return uncertainty_now(self.job, self.watch.rests)

    def decide(
        self, code: RunEvent, message: str, args: Args, *, level: EventLevel = EventLevel.INFO
    ) -> None:
        """Write a decision or result to the run file and tell the observer."""
        if level >= EventLevel.WARNING:
            self.tally.warning, self.tally.warned_s = message, self.machine.time_s
        self.recorder.append(EventRow(self.machine.time_s, code, level, message, args))
        self.observer.note(message)

    def begin(self, phase: Phase) -> None:
        """Tell the observer what comes now."""
        self.tally.phase = phase
        self.report_idle(self.machine.time_s, 0.0, NO_PULSES, self.watch.displacement_um)

    def report_idle(
        self,
        time_s: float,
        gap_v: float,
        ratios: PulseShares,
        displacement_um: float,
        between: Extremes = NOT_SAMPLED,
    ) -> None:
        """Tell the observer what is known while nothing is machined; `between` are the extremes since last time."""
        tally = self.tally
        self.observer.progress(
            Progress(
                phase=tally.phase,
                time_s=time_s,
                gap_v=gap_v,
                reference_v=gap_reference_v(self.profile),
                ratios=ratios,
                depth_um=tally.depth_um,
                depth_target_um=tally.depth_target_um,
                displacement_um=displacement_um,
                time_left_s=math.nan,
                site=self.site_among_many,
                gap_low_v=between.gap_low_v,
                gap_high_v=between.gap_high_v,
                displacement_low_um=between.displacement_low_um,
                displacement_high_um=between.displacement_high_um,
                sites_done=tally.sites_done,
                sites_total=len(self.job.sites),
                warning=tally.warning,
                warned_s=tally.warned_s,
            )
        )

    @property
    def site_among_many(self) -> str:
        """Name of the hole under way, empty where there is only one."""
        return self.tally.open_site if len(self.job.sites) > 1 else ""


def rest_and_look(run: JobRun, duration_s: float) -> None:
    """Rest for a time, and on until a sample has come that was taken in it.

    Time passes on a host that is held up and on a line that loses frames too, but what the tool did meanwhile is not
    known then, and a ramp that is planned from an older place goes too far. Where no sample comes at all the rest
    raises LinkLost E4022, as every wait does.
    """
    begin_s = run.machine.time_s
    run.machine.rest(duration_s)
    while run.watch.newest_s <= begin_s:
        run.machine.rest(LOOK_S)
