"""The state of a running job, told to the journal at every step and every few seconds of a cut."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

from edmctl.procedures.hole.estimating import energy_of
from edmctl.procedures.hole.expected_touches import (
    SAMPLES_LATE_S,
    Estimate,
    estimate_in_cut,
    estimate_left,
    estimate_touched,
    expected_of_left,
    most_um_s,
)
from edmctl.procedures.hole.interruption import after_pause
from edmctl.procedures.job_state import PERIOD_S, FaceTouch, JobState, Journal, NoJournal
from edmctl.procedures.tally import RunningCut

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.machine.interface import TelemetryBlock
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.hole.hole import Hole
    from edmctl.procedures.job import Job
    from edmctl.procedures.tally import JobTally
    from edmctl.procedures.touch.surface_plane import Face


MACHINING = "machining"
"""The phase in which the state is kept every few seconds."""


@dataclass(slots=True, eq=False)
class JobJournal:
    """Puts the state of a job together from its ledger and the hole or channel under way."""

    job: Job
    ledger: JobTally
    file: Journal = field(default_factory=NoJournal)
    _hole: Hole | None = None
    _channel: Callable[[JobState, float], JobState] | None = None
    _plan: CutPlan | None = None
    _face: tuple[FaceTouch, ...] = ()
    _face_doubt_u_um: float = 0.0
    _ended: Estimate | None = None
    _begun: bool = False
    _phase: str = ""
    _samples_late_s: float = 0.0
    _time_s: float = 0.0
    _kept_s: float = 0.0

    def __post_init__(self) -> None:
        if self.job.resumed is not None:
            self._face = self.job.resumed.face
            self._face_doubt_u_um = self.job.resumed.face_doubt_u_um

    def face(self, face: Face) -> None:
        """Note what was touched of the face, and what is doubted of it."""
        self._face, self._face_doubt_u_um = tuple(face.touched), face.doubt_u_um

    def doubt_face(self, u_um: float) -> None:
        """The face is less certain by a standard uncertainty."""
        self._face_doubt_u_um = math.hypot(self._face_doubt_u_um, u_um)

    def begin_hole(self, hole: Hole, time_s: float, *, begun: bool = False) -> None:
        """A hole whose Z1 is known; `begun` when an earlier run has cut it already."""
        self._hole, self._plan, self._ended, self._begun, self._time_s = hole, None, None, begun, time_s
        self._keep("measuring")

    def begin_cut(self, hole: Hole, plan: CutPlan) -> None:
        """Sparks come next."""
        self._hole, self._plan, self._ended, self._begun = hole, plan, None, True
        self.ledger.cut = RunningCut(displacement_um=plan.start.bottom_um - plan.start.gap_um)
        self._keep(MACHINING)

    def channel(self, told: Callable[[JobState, float], JobState], phase: str, time_s: float) -> None:
        """A channel is under way in a phase: `told` adds what is known of it at a time of the run, s, to a state."""
        self._channel, self._time_s = told, time_s
        self._keep(phase)

    def take(self, block: TelemetryBlock) -> None:
        """Hear the samples of the run; every few seconds of a cut its state is kept."""
        self._time_s = float(block.time_s[-1])
        if self._phase != MACHINING or self._time_s - self._kept_s < PERIOD_S:
            return
        self._keep(MACHINING, urgent=False)

    def end_cut(self, hole: Hole, cut: CutResult) -> None:
        """The cut has ended, and its sums are the hole's now."""
        assert self._plan is not None
        energy = energy_of(self.job.profile.pulse, cut.counts, cut.energy_j)
        self._ended = estimate_in_cut(self._plan, cut.end_displacement_um, energy, self._time_s)
        hole.sums.cuts.append(cut)
        self.ledger.cut = RunningCut(displacement_um=self.ledger.cut.displacement_um)
        self._plan = None
        self._keep("measuring")

    def end_hole(self) -> None:
        """The hole's result stands in the ledger."""
        self._hole, self._plan, self._ended, self._begun = None, None, None, False
        self._keep("moving")

    def stop(self, time_s: float, *, linked: bool) -> None:
        """The job ends early at that time: keep the newest times and estimates, at once where the line lives."""
        self._samples_late_s = (
            min(max(0.0, time_s - self._time_s), SAMPLES_LATE_S) if linked else SAMPLES_LATE_S
        )
        if not self._phase and self.job.resumed is not None:
            # Nothing was touched yet: what the run before knew stands.
            state = after_pause(self.job)
            age_s = state.home_age_s + time_s
            self.file.keep(replace(state, time_s=state.time_s + time_s, home_age_s=age_s), urgent=linked)
            return
        self._time_s = max(self._time_s, time_s)
        self._keep(self._phase or "starting", urgent=linked)

    def left(self) -> tuple[Hole, Estimate] | None:
        """The hole under way that nobody has touched since its last cut, and what is known of it."""
        hole = self._hole
        if hole is None or self.ledger.unmeasured_site != hole.site.name:
            return None
        known, resumed, profile = self._estimate(hole), self.job.resumed, self.job.profile
        unseen_um = 0.0
        if self._plan is not None:
            unseen_s = self._samples_late_s + self.job.setup.controller.watchdog_s
            unseen_um = unseen_s * most_um_s(known, hole.sums.time_s + self.ledger.cut.time_s, profile)
        elif self._ended is None and resumed is not None:
            unseen_um = expected_of_left(resumed, profile).unseen_um
        touched = hole.estimate.fits > 0 or hole.stops > 0
        return hole, known.left(unseen_um, hole.estimate.wear_ratio, touched=touched)

    def _keep(self, phase: str, *, urgent: bool = True) -> None:
        self._kept_s, self._phase = self._time_s, phase
        self.file.keep(self._state(phase), urgent=urgent)

    def _state(self, phase: str) -> JobState:
        hole, before_s = self._hole, self.ledger.earlier_time_s
        open_name = hole.site.name if hole else ""
        state = JobState(
            phase=phase,
            time_s=before_s + self._time_s,
            tool=self.job.profile.tool.label,
            face=self._face,
            face_doubt_u_um=self._face_doubt_u_um,
            done=tuple(asdict(result) for name, result in self.ledger.sites.items() if name != open_name),
            job_machining_time_s=self.ledger.machining_time_s,
            pause_s=self.ledger.pause_s,
            home_um=self.ledger.home_um,
            home_age_s=self._time_s - self.ledger.home_s,
        )
        if self._channel is not None:
            return self._channel(state, self._time_s)
        if hole is None:
            return state
        cut, sums, known = self.ledger.cut, hole.sums, self._estimate(hole)
        before = sums.counts
        return replace(
            state,
            site=open_name,
            begun=self._begun,
            z1_um=hole.z1.z_um,
            z1_sd_um=hole.z1.reading.sd_um,
            z1_touches=hole.z1.reading.touches,
            z1_u_um=hole.z1_u_um,
            z1_doubt_u_um=hole.z1.doubt_u_um,
            z1_time_s=before_s + hole.z1.time_s,
            z1_model_um=hole.z1.model_um,
            displacement_um=0.0 if math.isnan(cut.displacement_um) else cut.displacement_um,
            depth_um=known.depth_um,
            depth_u_um=known.depth_u_um,
            wear_um=known.wear_um,
            wear_u_um=known.wear_u_um,
            feed_u_um=known.feed_u_um,
            cuts=sums.number + (self._plan is not None),
            broken_cuts=sums.broken_cuts + (self._plan is not None),
            counts=(
                before[0] + cut.counts[0],
                before[1] + cut.counts[1],
                before[2] + cut.counts[2],
                before[3] + cut.counts[3],
            ),
            energy_j=sums.energy_j + cut.energy_j,
            machining_time_s=sums.time_s + cut.time_s,
        )

    def _estimate(self, hole: Hole) -> Estimate:
        """What is known of the hole under way: by the cut, by the last touches, by the run before."""
        cut = self.ledger.cut
        if self._plan is not None and not math.isnan(cut.displacement_um):
            energy = energy_of(self.job.profile.pulse, cut.counts, cut.energy_j)
            return estimate_in_cut(self._plan, cut.displacement_um, energy, self._time_s)
        if self._ended is not None and self.ledger.unmeasured_site == hole.site.name:
            return self._ended
        if hole.found is not None:
            return estimate_touched(hole.found)
        if hole.interrupted and self.job.resumed is not None:
            return estimate_left(self.job.resumed)
        return Estimate()
