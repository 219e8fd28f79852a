"""Samples and pulses of a machine in blocks, in µm, V, A and s; shares of pulse classes; statistics of the link.

Displacements are those of the inductive sensor on the actuator, positive towards the work and zero near 0 V.
Times are seconds since the first message of the run, on the controller's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, fields
from edmctl.results.declared import ONLY_JSON, PURE, quantity

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    AnyFloats = NDArray[np.floating]
    Counts = NDArray[np.integer]
    from edmctl.array_types import Array


@dataclass(frozen=True, slots=True)
class PulseShares:
    """Share of the pulses in each class; they sum to 1, or are all 0 when there was no pulse."""

    open: float = quantity(PURE, "share of open pulses")
    normal: float = quantity(PURE, "share of normal discharges")
    arc: float = quantity(PURE, "share of arcs")
    short: float = quantity(PURE, "share of shorts")


PULSE_CLASSES = tuple(one.name for one in fields(PulseShares))


def pulse_shares(open_count: float, normal_count: float, arc_count: float, short_count: float) -> PulseShares:
    """Shares from counts."""
    total = open_count + normal_count + arc_count + short_count
    counts = (open_count, normal_count, arc_count, short_count)
    return PulseShares(*(count / total if total > 0 else 0.0 for count in counts))


@dataclass(slots=True, eq=False)
class BlockSummary:
    """Means, extremes and sums over a block; `counts` are pulses by class, `state` is None if it changes."""

    samples: int
    end_s: float
    mean_um: float
    low_um: float
    high_um: float
    gap_mean_v: float
    gap_high_v: float
    current_mean_a: float
    current_high_a: float
    actuator_high_v: float
    counts: tuple[int, int, int, int]
    state: int | None


@dataclass
class TelemetryBlock:
    """Consecutive servo samples in columns, each of shape (n,).

    `gap_v` is the filtered mean gap voltage, `current_a` the mean gap current; `n_*` count the pulses of each
    class since the sample before. `missing_frames` frames were lost on the line before this block.
    """

    time_s: Array = quantity("s", "time since start")
    displacement_um: Array = quantity(
        "um", "tool displacement, sensor; NaN without one", dtype="f4", column="z_sensor"
    )
    actuator_v: Array = quantity("V", "actuator voltage", dtype="f4", column="v_cmd")
    gap_v: Array = quantity("V", "mean gap voltage", dtype="f4", column="v_gap_avg")
    current_a: Array = quantity("A", "mean gap current", dtype="f4")
    n_open: Counts = quantity(PURE, "open pulses", dtype="u1")
    n_normal: Counts = quantity(PURE, "normal discharges", dtype="u1")
    n_arc: Counts = quantity(PURE, "arcs", dtype="u1")
    n_short: Counts = quantity(PURE, "shorts", dtype="u1")
    state: Counts = quantity(PURE, "state of the controller", dtype="u1")
    flags: Counts = quantity(PURE, "TlmFlags of the protocol", dtype="u1")
    missing_frames: int = quantity(PURE, "frames lost on the line before this block", ONLY_JSON)

    @cached_property
    def summary(self) -> BlockSummary:
        """The summary of the samples, made once. Sums of some ten numbers take less time in lists than in arrays."""
        heights_um, gaps_v, currents_a = (
            self.displacement_um.tolist(),
            self.gap_v.tolist(),
            self.current_a.tolist(),
        )
        n, first, last = len(heights_um), self.state.item(0), self.state.item(-1)
        pulses = (self.n_open, self.n_normal, self.n_arc, self.n_short)
        opens, normals, arcs, shorts = (sum(numbers.tolist()) for numbers in pulses)
        return BlockSummary(
            samples=n,
            end_s=self.time_s.item(-1),
            mean_um=sum(heights_um) / n,
            low_um=min(heights_um),
            high_um=max(heights_um),
            gap_mean_v=sum(gaps_v) / n,
            gap_high_v=max(gaps_v),
            current_mean_a=sum(currents_a) / n,
            current_high_a=max(currents_a),
            actuator_high_v=max(self.actuator_v.tolist()),
            counts=(opens, normals, arcs, shorts),
            state=first if first == last else None,
        )


_COLUMNS = tuple(one.name for one in fields(TelemetryBlock) if one.name != "missing_frames")


def joined(blocks: Sequence[TelemetryBlock]) -> TelemetryBlock:
    """Return consecutive blocks as one."""
    import numpy as np

    if len(blocks) == 1:
        return blocks[0]
    columns = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in _COLUMNS}
    return TelemetryBlock(**columns, missing_frames=sum(block.missing_frames for block in blocks))


@dataclass(slots=True)
class PulseBlockBatch:
    """Sums over consecutive blocks of pulses, columns of shape (n,): ignition delays in µs, energies in µJ."""

    time_s: AnyFloats = quantity("s", "time since start")
    n_open: Counts = quantity(PURE, "open pulses", dtype="u1")
    n_normal: Counts = quantity(PURE, "normal discharges", dtype="u1")
    n_arc: Counts = quantity(PURE, "arcs", dtype="u1")
    n_short: Counts = quantity(PURE, "shorts", dtype="u1")
    delay_us: AnyFloats = quantity("us", "sum of the ignition delays", dtype="f4", column="sum_td")
    energy_uj: AnyFloats = quantity("uJ", "sum of the discharge energies", dtype="f4", column="sum_energy")


@dataclass(frozen=True, slots=True)
class PulseTrain:
    """Consecutive pulses of one period, in columns of shape (n,). `pulse_class` holds `PulseClass` values."""

    first_pulse: int
    start_s: float
    period_s: float
    pulse_class: Counts
    delay_us: AnyFloats
    discharge_us: AnyFloats
    plateau_v: AnyFloats


@dataclass(frozen=True, slots=True)
class WaveformBatch:
    """The gap about a latched fault, sample by sample at equal distances, columns of shape (n,)."""

    time_s: AnyFloats = quantity("s", "time since start")
    gap_v: AnyFloats = quantity("V", "gap voltage", dtype="f4", column="v_gap")
    current_a: AnyFloats = quantity("A", "gap current", dtype="f4", column="i_gap")


@dataclass(frozen=True, slots=True)
class LinkReport:
    """Statistics of the link so far; `controller_*` count host frames that the controller discarded.

    The clock is the controller's against the host's: offset in s, rate as deviation from one in ppm.
    """

    frames_sent: int = quantity(PURE, "frames sent", dtype="u8")
    frames_received: int = quantity(PURE, "frames received", dtype="u8")
    bad_frames: int = quantity(PURE, "damaged frames received", dtype="u4")
    retries: int = quantity(PURE, "commands repeated", dtype="u4")
    lost_frames: int = quantity(PURE, "telemetry frames missing", dtype="u4")
    controller_bad_frames: int = quantity(
        PURE, "damaged frames that the controller got", dtype="u4", column="bad_frames_there"
    )
    controller_dropped_frames: int = quantity(
        PURE, "frames that the controller dropped", dtype="u4", column="dropped_there"
    )
    rtt_p50_ms: float = quantity("ms", "round trip of a command, median", dtype="f4")
    rtt_p99_ms: float = quantity("ms", "round trip of a command, 99th percentile", dtype="f4")
    clock_offset_s: float = quantity("s", "clock of the controller ahead of the host's")
    clock_rate_ppm: float = quantity("ppm", "clock of the controller faster than the host's", dtype="f4")
    clock_residual_us: float = quantity("us", "scatter of the clocks about offset and rate", ONLY_JSON)
