"""Bring the actuator's memory into a known state beside the work, and identify the model from that record.

Hysteresis remembers the turning points of the voltage; full swings wipe out whatever came before. Without
them a model is wrong by tens of µm near 0 V (Muralidhara et al. 2009, §2.2, near the trough of Fig. 3a).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.estimator import identify_play_model
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.results import Phase
from edmctl.procedures.stages import move_to

if TYPE_CHECKING:
    from edmctl.machine.port import TelemetryBlock
    from edmctl.procedures.run import Run

REST_S = 1.0
"""Rest before the first swing: the record starts from a standing actuator."""


def condition(run: Run) -> None:
    """Swing the actuator between 0 V and its limit at the parking place, and start the estimator from there.

    The machine is idle while the model is fitted, because a fitting host sends no heartbeats.
    """
    move_to(run, run.job.parking)
    run.begin(Phase.CONDITIONING)
    record: list[TelemetryBlock] = []
    run.watch.follow(record.append)
    try:
        run.machine.rest(REST_S)
        _swing(run)
        run.machine.disarm()
    finally:
        run.watch.follow(None)
    if run.setup.actuator.conditioning_cycles:
        _identify(run, record)
    run.machine.arm()


def _swing(run: Run) -> None:
    actuator = run.setup.actuator
    for _ in range(actuator.conditioning_cycles):
        run.machine.ramp(run.profile.limits.stroke_v_max, actuator.conditioning_slew_v_s)
        run.machine.ramp(0.0, actuator.conditioning_slew_v_s)


def _identify(run: Run, record: list[TelemetryBlock]) -> None:
    found = identify_play_model(
        np.concatenate([block.time_s for block in record]),
        np.concatenate([block.actuator_v for block in record]),
        np.concatenate([block.displacement_um for block in record]),
    )
    run.watch.estimate_with(found.model)
    top_v = run.profile.limits.stroke_v_max
    cycles = run.setup.actuator.conditioning_cycles
    run.decide(
        RunEvent.CONDITIONED,
        f"Conditioned with {cycles} swings to {top_v:.0f} V; the actuator model fits "
        f"within {found.rms_um:.2f} µm rms, {found.max_um:.1f} µm at most.",
        {"cycles": cycles, "rms_um": found.rms_um, "max_um": found.max_um},
    )
