"""What the controller kept of the time about a fault, into the run file: its black box and the gap's waveforms."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.errors import LinkLost, MachineFault, PreconditionError, ProtocolMismatch

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
        if not run.setup.sensor.fitted:
            block = replace(block, displacement_um=np.full(len(block.time_s), np.nan))
        run.recorder.black_box(block)


def _record_waveforms(run: Run) -> None:
    batch = run.machine.waveforms()
    if batch is not None:
        run.recorder.waveforms(batch)
