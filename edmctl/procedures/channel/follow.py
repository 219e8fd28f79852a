"""Follows the telemetry of one pass of a channel: sums, progress, and what should not go on."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from edmctl.machine.port import MachineState, TelemetryBlock
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.settings import gap_reference_v, telemetry_settings
from edmctl.procedures.tally import RunningCut
from edmctl.process.channel_wear import wearing_uj
from edmctl.record.rows import EventLevel, SlowRow
from edmctl.results.progress import Phase, Progress
from edmctl.results.pulses import PulseShares, pulse_shares

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

RATIO_WINDOW_S = 2.0
"""Arcs and shorts are judged over this."""
UNSTABLE_S = 30.0
"""A pass over its arc or short limit for so long is ended: a scan flushes its gap by moving."""

_Counts = tuple[int, int, int, int]


class PassFollower:
    """Keeps the sums of the pass `number` that begins at `start_s`, and the tally of the job current.

    `counts` are its pulses by class (open, normal, arc, short), `energy_j` their energy, from the mean gap current
    at the plateau voltage of a normal discharge. `displacement_um` is of the newest block. Whoever scans sets
    `depth_um`, `wear_um`, `wear_u95_um` and `time_left_s`. `unstable` says why a pass should end,
    `shorted` that most pulses of the last seconds were shorts.
    """

    def __init__(self, run: Run, start_s: float, number: int = 0) -> None:
        profile = run.profile
        self._run = run
        self._step = f"pass {number}" if number else ""
        self._start_s = start_s
        self._machined_before_s = run.tally.machining_time_s
        self._duty_v = profile.pulse.duty_voltage_v
        self._reference_v = gap_reference_v(profile)
        self._plateau_v = profile.pulse.discharge_voltage_v
        self._sample_s = 1e-6 * telemetry_settings(profile, run.setup).period_us
        self._window: deque[tuple[float, _Counts]] = deque()
        self._over_since_s: dict[RunEvent, float] = {}
        self._gap_ratio_sum = 0.0
        self._samples = 0
        self.counts = [0, 0, 0, 0]
        self.energy_j = 0.0
        self.displacement_um = math.nan
        self.depth_um = run.tally.depth_um
        self.wear_um = self.wear_u95_um = math.nan
        self.time_left_s = math.nan
        self.unstable = ""
        self.shorted = False
        run.tally.phase = Phase.MACHINING

    @property
    def gap_ratio_mean(self) -> float:
        """Mean of the normalised gap voltage; NaN before any sample."""
        return self._gap_ratio_sum / self._samples if self._samples else math.nan

    @property
    def wearing_uj(self) -> float:
        """Energy of this pass so far that wore the tool."""
        return wearing_uj(energy_of(self._run.profile.pulse, self.counts, self.energy_j))

    def take(self, block: TelemetryBlock) -> None:
        """Take the samples of one slice."""
        now_s, n = float(block.time_s[-1]), len(block.time_s)
        gap_v = float(block.gap_v.mean())
        ratios = self._count(block, now_s)
        self.shorted = ratios.short > 0.5
        power_w = self._plateau_v * float(block.current_a.mean())
        self.energy_j += power_w * n * self._sample_s
        if block.state[0] == block.state[-1] == MachineState.MACHINING:
            self._gap_ratio_sum += gap_v / self._duty_v * n
            self._samples += n
            self.displacement_um = float(block.displacement_um.mean())
        limits = self._run.profile.limits
        self._look_at(RunEvent.ARCING, "arcs", ratios.arc, limits.arc_ratio, now_s)
        self._look_at(RunEvent.SHORTING, "shorts", ratios.short, limits.short_ratio, now_s)
        tally = self._run.tally
        tally.depth_um = self.depth_um
        cut_s = max(0.0, now_s - self._start_s)
        tally.machining_time_s = self._machined_before_s + cut_s
        opens, normals, arcs, shorts = self.counts
        tally.cut = RunningCut((opens, normals, arcs, shorts), self.energy_j, cut_s, self.displacement_um)
        self._record(now_s, gap_v, ratios, power_w)
        self._tell(block, now_s, gap_v, ratios)

    def _count(self, block: TelemetryBlock, now_s: float) -> PulseShares:
        """Add the pulses of a block; the shares of the last seconds."""
        fresh = (
            int(block.n_open.sum()),
            int(block.n_normal.sum()),
            int(block.n_arc.sum()),
            int(block.n_short.sum()),
        )
        self.counts = [total + number for total, number in zip(self.counts, fresh, strict=True)]
        self._window.append((now_s, fresh))
        while self._window[0][0] <= now_s - RATIO_WINDOW_S:
            self._window.popleft()
        return pulse_shares(*(sum(column) for column in zip(*(c for _, c in self._window), strict=True)))

    def _record(self, now_s: float, gap_v: float, ratios: PulseShares, power_w: float) -> None:
        self._run.recorder.append_slow(
            SlowRow(
                time_s=now_s,
                feed_um_s=math.nan,
                gap_ratio=gap_v / self._duty_v,
                gap_ratio_ref=self._reference_v / self._duty_v,
                ratio_open=ratios.open,
                ratio_normal=ratios.normal,
                ratio_arc=ratios.arc,
                ratio_short=ratios.short,
                depth_um=self.depth_um,
                wear_um=self.wear_um,
                wear_u95_um=self.wear_u95_um,
                power_w=power_w,
                link_errors=self._run.watch.missing_frames,
            )
        )

    def _tell(self, block: TelemetryBlock, now_s: float, gap_v: float, ratios: PulseShares) -> None:
        tally = self._run.tally
        self._run.observer.progress(
            Progress(
                phase=Phase.MACHINING,
                time_s=now_s,
                gap_v=gap_v,
                reference_v=self._reference_v,
                ratios=ratios,
                depth_um=self.depth_um,
                depth_target_um=tally.depth_target_um,
                displacement_um=self.displacement_um,
                time_left_s=self.time_left_s,
                step=self._step,
                wear_um=self.wear_um,
                wear_u95_um=self.wear_u95_um,
                gap_low_v=float(block.gap_v.min()),
                gap_high_v=float(block.gap_v.max()),
                displacement_low_um=float(block.displacement_um.min()),
                displacement_high_um=float(block.displacement_um.max()),
                warning=tally.warning,
                warned_s=tally.warned_s,
            )
        )

    def _look_at(self, code: RunEvent, name: str, ratio: float, limit: float, now_s: float) -> None:
        """Tell once that a share of pulses is over its limit, and end the pass where it stays there."""
        if ratio <= limit:
            self._over_since_s.pop(code, None)
            return
        if now_s - self._window[0][0] < 0.9 * RATIO_WINDOW_S:
            return
        if code not in self._over_since_s:
            self._over_since_s[code] = now_s
            self._run.decide(
                code,
                f"{100 * ratio:.0f} % {name} in the last {RATIO_WINDOW_S:.0f} s; the limit is {100 * limit:.0f} %.",
                {"ratio": ratio, "limit": limit},
                level=EventLevel.WARNING,
            )
        elif now_s - self._over_since_s[code] > UNSTABLE_S:
            self.unstable = f"{name} have stayed over their limit"
