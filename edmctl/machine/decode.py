"""Wire records as columns in physical units, several frames at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from edmctl.array_types import Array
from edmctl.link.messages import PulseBlocks, Pulses, Tlm, WaveformReadReply
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

ToSeconds = Callable[[int], float]
"""Controller time in µs, modulo 2^32, as seconds of the run."""

_SAME_TRAIN_US = 100.0
"""Frames of pulses further apart than this, beyond their own length, have a pause between them."""

_TLM_DTYPE = Tlm.record_dtype()
_BLOCK_DTYPE = PulseBlocks.record_dtype()
_PULSE_DTYPE = Pulses.record_dtype()
_WAVEFORM_DTYPE = WaveformReadReply.record_dtype()
_TLM_SCALE = Tlm.record_scales()
_BLOCK_SCALE = PulseBlocks.record_scales()
_PULSE_SCALE = Pulses.record_scales()
_WAVEFORM_SCALE = WaveformReadReply.record_scales()


def _times(starts_s: Sequence[float], counts: Sequence[int], step_us: float) -> Array:
    """Return the times of records that are `step_us` apart within each frame, s.

    Frames begin at whole microseconds; samples at whole ones too have the same times however they are framed.
    """
    pairs = zip(starts_s, counts, strict=True)
    return np.concatenate([round(start * 1e6) + _steps(n, step_us) for start, n in pairs]) / 1e6


@lru_cache(maxsize=64)
def _steps(n: int, step_us: float) -> Array:
    """Return multiples of `step_us`, shared between frames of one size and therefore read-only."""
    steps = step_us * np.arange(n, dtype=np.float64)
    steps.flags.writeable = False
    return steps


def telemetry_block(frames: Sequence[Tlm], to_seconds: ToSeconds, missing_frames: int) -> TelemetryBlock:
    """Return the samples of consecutive frames with one sample period, shape (n,) per column."""
    data = frames[0].records if len(frames) == 1 else b"".join(frame.records for frame in frames)
    starts = [to_seconds(frame.t0_us) for frame in frames]
    time_s = _times(starts, [frame.n for frame in frames], frames[0].period_us)
    rows = np.frombuffer(data, dtype=_TLM_DTYPE)
    return TelemetryBlock(
        time_s=time_s,
        displacement_um=rows["displacement_um"] * _TLM_SCALE["displacement_um"],
        actuator_v=rows["actuator_v"] * _TLM_SCALE["actuator_v"],
        gap_v=rows["gap_v"] * _TLM_SCALE["gap_v"],
        current_a=rows["current_a"] * _TLM_SCALE["current_a"],
        n_open=rows["n_open"],
        n_normal=rows["n_normal"],
        n_arc=rows["n_arc"],
        n_short=rows["n_short"],
        state=rows["state"],
        flags=rows["flags"],
        missing_frames=missing_frames,
    )


def pulse_block_batch(frames: Sequence[PulseBlocks], to_seconds: ToSeconds) -> PulseBlockBatch:
    """Return the pulse blocks of consecutive frames with one block size, shape (n,) per column."""
    rows = np.frombuffer(b"".join(frame.records for frame in frames), dtype=_BLOCK_DTYPE)
    starts = [to_seconds(frame.t0_us) for frame in frames]
    step_us = 1e-3 * frames[0].period_ns * frames[0].block_pulses
    return PulseBlockBatch(
        time_s=_times(starts, [frame.n for frame in frames], step_us),
        n_open=rows["n_open"],
        n_normal=rows["n_normal"],
        n_arc=rows["n_arc"],
        n_short=rows["n_short"],
        delay_us=rows["delay_us"] * _BLOCK_SCALE["delay_us"],
        energy_uj=rows["energy_uj"] * _BLOCK_SCALE["energy_uj"],
    )


def pulse_batches(frames: Sequence[Pulses], to_seconds: ToSeconds) -> list[PulseTrain]:
    """Return one batch for each run of frames whose pulses follow each other without a pause."""
    runs: list[list[Pulses]] = []
    for frame in frames:
        if runs and _follows(runs[-1][-1], frame):
            runs[-1].append(frame)
        else:
            runs.append([frame])
    return [_pulse_batch(run, to_seconds) for run in runs]


def _follows(before: Pulses, after: Pulses) -> bool:
    elapsed_us = (after.t0_us - before.t0_us) & 0xFFFF_FFFF
    expected_us = 1e-3 * before.period_ns * before.n
    return after.pulse_no == before.pulse_no + before.n and abs(elapsed_us - expected_us) < _SAME_TRAIN_US


def _pulse_batch(frames: Sequence[Pulses], to_seconds: ToSeconds) -> PulseTrain:
    rows = np.frombuffer(b"".join(frame.records for frame in frames), dtype=_PULSE_DTYPE)
    return PulseTrain(
        first_pulse=frames[0].pulse_no,
        start_s=to_seconds(frames[0].t0_us),
        period_s=1e-9 * frames[0].period_ns,
        pulse_class=rows["pulse_class"],
        delay_us=rows["delay_us"] * _PULSE_SCALE["delay_us"],
        discharge_us=rows["discharge_us"] * _PULSE_SCALE["discharge_us"],
        plateau_v=rows["plateau_v"] * _PULSE_SCALE["plateau_v"],
    )


def waveform_batch(pages: Sequence[WaveformReadReply], to_seconds: ToSeconds) -> WaveformBatch:
    """Return the pages of one snapshot as one, in order and without gaps."""
    rows = np.frombuffer(b"".join(page.records for page in pages), dtype=_WAVEFORM_DTYPE)
    first = pages[0]
    return WaveformBatch(
        time_s=_times([to_seconds(first.t0_us)], [len(rows)], 1e-3 * first.period_ns),
        gap_v=rows["gap_v"] * _WAVEFORM_SCALE["gap_v"],
        current_a=rows["current_a"] * _WAVEFORM_SCALE["current_a"],
    )
