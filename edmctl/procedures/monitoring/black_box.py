"""What the controller kept of the time about a fault, into the run file: its black box and the gap's waveforms."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from edmctl.errors import LinkLost, MachineFault, PreconditionError, ProtocolMismatch
from edmctl.record.rows import BlackBoxBlock, WaveformBlock

if TYPE_CHECKING:
    from edmctl.procedures.run import Run


def record_black_box(run: Run) -> None:
    """Read what a latched fault froze, where there is one.

    A line that is dead by now, or a controller that says what cannot be, hides nothing.
    """
    with suppress(LinkLost, ProtocolMismatch, MachineFault, PreconditionError):
        if not run.machine.status().fault:
            return
        _record_samples(run)
        _record_waveforms(run)


def _record_samples(run: Run) -> None:
    with suppress(PreconditionError):
        block = run.machine.black_box()
        if block is None:
            return
        sensor = run.setup.sensor.fitted
        run.recorder.black_box(
            BlackBoxBlock(
                time_s=block.time_s,
                actuator_v=block.actuator_v,
                displacement_um=block.displacement_um if sensor else np.full(len(block.time_s), np.nan),
                gap_v=block.gap_v,
                current_a=block.current_a,
                n_open=block.n_open,
                n_normal=block.n_normal,
                n_arc=block.n_arc,
                n_short=block.n_short,
                state=block.state,
                flags=block.flags,
            )
        )


def _record_waveforms(run: Run) -> None:
    batch = run.machine.waveforms()
    if batch is not None:
        run.recorder.waveforms(WaveformBlock(batch.time_s, batch.gap_v, batch.current_a))
