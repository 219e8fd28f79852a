"""Bring the actuator's memory into a known state beside the work, and start the estimator there.

Hysteresis remembers the turning points of the voltage; full swings wipe out whatever came before. Without
them a model is wrong by tens of µm near 0 V (Muralidhara et al. 2009, §2.2, near the trough of Fig. 3a).

The swings are also the home of the estimator: they are compared with the sensor over the whole stroke, which
sets today's gain and zero of a calibration. Without a calibration a plain model is identified from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.inverse import jump_volts
from edmctl.actuator.record import Record
from edmctl.errors import PreconditionError
from edmctl.machine.interface import joined
from edmctl.procedures.actuator.tracker import home
from edmctl.procedures.run import rest_and_look
from edmctl.procedures.stages import move_to
from edmctl.record.rows import RunEvent
from edmctl.results.progress import Phase
from edmctl.wording import signed

if TYPE_CHECKING:
    from edmctl.machine.interface import TelemetryBlock
    from edmctl.procedures.run import JobRun

LEAST_GAIN_UM_PER_V = 0.05
"""Half the least mean gain that a setup may have."""
REST_S = 1.0
"""Rest before the first swing: the record starts from a standing actuator."""


def condition(run: JobRun, *, pulses: bool = True) -> None:
    """Swing the actuator between 0 V and its limit at the parking place, and start the estimator from there.

    The machine is idle while the model is fitted, because a fitting host sends no heartbeats; then it is armed
    again, with `pulses` permitted or not.
    """
    move_to(run, run.job.parking)
    run.begin(Phase.CONDITIONING)
    record: list[TelemetryBlock] = []
    run.watch.follow(record.append)
    try:
        rest_and_look(run, REST_S)
        _swing(run)
        run.machine.disarm()
    finally:
        run.watch.follow(None)
    if run.setup.sensor.fitted:
        _start_estimator(run, joined(record))
    else:
        cycles = run.setup.actuator.conditioning_cycles
        top_v = run.profile.limits.stroke_v_max
        message = f"Conditioned with {cycles} swings to {top_v:.0f} V; there is no sensor to compare with."
        run.decide(RunEvent.CONDITIONED, message, {"cycles": cycles})
    _load_inverse(run)
    run.machine.arm(pulses=pulses)


def _swing(run: JobRun) -> None:
    actuator = run.setup.actuator
    for _ in range(actuator.conditioning_cycles):
        run.machine.ramp(run.profile.limits.stroke_v_max, actuator.conditioning_slew_v_s)
        run.machine.ramp(0.0, actuator.conditioning_slew_v_s)


def _start_estimator(run: JobRun, block: TelemetryBlock) -> None:
    """From a conditioned actuator at rest through the swings on the voltage really applied, then home."""
    record = Record(block.time_s, block.actuator_v, block.displacement_um)
    calibration, cycles = run.job.calibration, run.setup.actuator.conditioning_cycles
    if cycles:
        _refuse_dead_sensor(record)
    if calibration is not None:
        tracker, errors = home(calibration.model, record, calibration.held_out_rms_um)
    elif cycles:
        from edmctl.actuator.identification import identify_quick

        try:
            model, quick = identify_quick(record)
        except ValueError as error:
            raise PreconditionError(
                f"The conditioning swings tell too little of the actuator: {error}.",
                hint="Lower actuator.conditioning_slew_v_s, or raise actuator.conditioning_cycles or "
                "controller.telemetry_hz in the setup.",
                code="E8036",
            ) from error
        tracker, errors = home(model, record, quick.rms_um)
    else:
        return
    run.watch.estimate_with(tracker)
    run.decide(
        RunEvent.CONDITIONED,
        f"Conditioned with {cycles} swings to {run.profile.limits.stroke_v_max:.0f} V; the actuator model fits "
        f"within {errors.rms_um:.2f} µm rms, {errors.max_um:.1f} µm at most.",
        {
            "cycles": cycles,
            "rms_um": errors.rms_um,
            "max_um": errors.max_um,
            "gain": tracker.estimator.gain,
            "offset_um": tracker.estimator.offset_um,
        },
    )


def _load_inverse(run: JobRun) -> None:
    """Use the inverse model once while nothing waits: where its code is not compiled yet, that takes seconds."""
    estimator = run.watch.estimator()
    if estimator is not None:
        jump_volts(estimator, 1.0, 0.0, 0.01, 0.0)


def _refuse_dead_sensor(record: Record) -> None:
    """Raise PreconditionError E8033 where the sensor does not rise with the voltage: nothing may rely on it."""
    slope_um_per_v = float(np.cov(record.u_v, record.y_um)[0, 1]) / max(float(record.u_v.var()), 1e-12)
    if slope_um_per_v > LEAST_GAIN_UM_PER_V:
        return
    raise PreconditionError(
        f"The displacement sensor shows {signed(slope_um_per_v)} µm per volt while the actuator swings over "
        f"{np.ptp(record.u_v):.0f} V.",
        hint="Check the sensor, its cable and its sign; without one say sensor.fitted = false in the setup.",
        code="E8033",
    )
