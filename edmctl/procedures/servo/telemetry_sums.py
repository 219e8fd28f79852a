"""Sums of the telemetry of one cut or pass: pulses by class, their energy, the gap voltage."""

from __future__ import annotations

import math
from collections import deque

from edmctl.machine.interface import MachineStatus
from edmctl.procedures.hole.cut_planning import discharge_energy_j
from edmctl.procedures.job_state import Counts
from edmctl.procedures.run import JobRun
from edmctl.procedures.settings import telemetry_settings
from edmctl.profile.model import Pulse
from edmctl.record.rows import SlowRow
from edmctl.results.progress import Progress
from edmctl.results.telemetry import BlockSummary, PulseShares, pulse_shares

RATIO_WINDOW_S = 2.0
"""Window of arcs and shorts; a limit that is exceeded over it is reported at once (decision 0012)."""


class TelemetrySums:
    """Sums over the slices of one cut or pass.

    `counts` are its pulses by class (open, normal, arc, short), `energy_j` is the energy of its discharges and
    `power_w` their mean power in the newest slice. `duty_v` is the mean voltage of an open gap.
    """

    def __init__(self, run: JobRun) -> None:
        self._run = run
        self.duty_v = run.profile.pulse.duty_voltage_v
        self._sample_s = 1e-6 * telemetry_settings(run.profile, run.setup).period_us
        self._window: deque[tuple[float, float, Counts]] = deque()
        self._window_counts = [0, 0, 0, 0]
        self._gap_ratio_sum = 0.0
        self._gap_samples = 0
        self._newest_s = math.nan
        self.counts = [0, 0, 0, 0]
        self.energy_j = self.power_w = 0.0

    @property
    def total(self) -> Counts:
        """The pulses by class."""
        opens, normals, arcs, shorts = self.counts
        return opens, normals, arcs, shorts

    @property
    def ratios(self) -> PulseShares:
        """Shares over the last `RATIO_WINDOW_S`; of the oldest slice by the part that lies in it."""
        if not self._window:
            return pulse_shares(0, 0, 0, 0)
        end_s, duration_s, oldest = self._window[0]
        before_s = self._newest_s - RATIO_WINDOW_S - (end_s - duration_s)
        left_out = min(max(before_s / duration_s, 0.0), 1.0)
        opens, normals, arcs, shorts = self._window_counts
        return pulse_shares(
            opens - left_out * oldest[0],
            normals - left_out * oldest[1],
            arcs - left_out * oldest[2],
            shorts - left_out * oldest[3],
        )

    @property
    def window_is_full(self) -> bool:
        """Whether the samples cover the window."""
        end_s, duration_s, _ = self._window[0]
        return self._newest_s - end_s + duration_s >= 0.9 * RATIO_WINDOW_S

    @property
    def gap_ratio_mean(self) -> float:
        """Mean of the normalised gap voltage while sparking; NaN before any sample."""
        return self._gap_ratio_sum / self._gap_samples if self._gap_samples else math.nan

    def duration_s(self, seen: BlockSummary) -> float:
        """Return the time that the samples of a slice cover."""
        return seen.samples * self._sample_s

    def add(self, seen: BlockSummary) -> Counts:
        """Add a slice; return its pulses."""
        self._newest_s, fresh = seen.end_s, seen.counts
        duration_s = self.duration_s(seen)
        energy_j = discharge_energy_j(self._pulse(), fresh, seen.current_mean_a * duration_s)
        self.energy_j += energy_j
        self.power_w = energy_j / duration_s
        self._window.append((self._newest_s, duration_s, fresh))
        for i, number in enumerate(fresh):
            self.counts[i] += number
            self._window_counts[i] += number
        while self._window[0][0] <= self._newest_s - RATIO_WINDOW_S:
            for i, number in enumerate(self._window.popleft()[2]):
                self._window_counts[i] -= number
        return fresh

    def add_gap_ratio(self, gap_ratio: float, samples: int) -> None:
        """Add the mean normalised gap voltage of samples while sparking."""
        self._gap_ratio_sum += gap_ratio * samples
        self._gap_samples += samples

    def _pulse(self) -> Pulse:
        """Return the pulses of the recipe at the duty in use."""
        pulse = self._run.profile.pulse
        if self.duty_v == pulse.duty_voltage_v:
            return pulse
        return pulse.model_copy(update={"duty": self.duty_v / pulse.open_voltage_v})

    def record(self, progress: Progress, status: MachineStatus | None = None) -> None:
        """Record the progress, with the power and the state of the dielectric."""
        run, ratios, duty_v = self._run, progress.ratios, self.duty_v
        run.recorder.append(
            SlowRow(
                time_s=progress.time_s,
                feed_um_s=progress.feed_um_s,
                gap_ratio=progress.gap_v / duty_v,
                gap_ratio_ref=progress.reference_v / duty_v,
                ratio_open=ratios.open,
                ratio_normal=ratios.normal,
                ratio_arc=ratios.arc,
                ratio_short=ratios.short,
                depth_um=progress.depth_um,
                depth_u95_um=progress.depth_u95_um,
                wear_um=progress.wear_um,
                wear_u95_um=progress.wear_u95_um,
                jump_period_s=progress.jump_period_s,
                power_w=self.power_w,
                dielectric_c=math.nan if status is None else status.temperature_c,
                flow_lpm=math.nan if status is None else status.flow_lpm,
                link_errors=run.watch.missing_frames,
            )
        )
