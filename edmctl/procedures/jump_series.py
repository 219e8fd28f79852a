"""Electrode jumps in free space, measured one by one: height, residual displacement, settling time.

The tool is as low as at the end of a hole, beside the work and without pulses, and jumps repeatedly (Muralidhara et
al. 2009, §2.2 and Fig. 5, where ramps and drops of the voltage leave an error of some µm).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.array_types import Array
from edmctl.machine.interface import MachineState, TelemetryBlock
from edmctl.planning.removal import jump_time_s
from edmctl.procedures.hole.cut import jump_request
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.approach import lower_to
from edmctl.record.rows import RunEvent
from edmctl.results.measurements import JumpMeasured, JumpSeries, JumpSummary
from edmctl.results.progress import Phase
from edmctl.results.telemetry import joined
from edmctl.wording import signed

SETTLE_AT_DEPTH_S = 20.0  # several times the creep after a large step (Muralidhara et al. 2009, Fig. 4)
BASE_S = 0.3  # averaging time before a jump and at the end of the time after it: 0.15 µm rms become 0.01 µm
LEAST_REST_S = 1.0  # least time from the end of a jump to the next one
LOOKED_AT_S = 8.0  # longest time after a jump: later motion is creep
TOP_S = 0.005  # averaging time about the top: shorter than the dwell, longer than ringing and noise
SMOOTHED_S = 0.02
SETTLED_UM = 1.0  # a tool within this of its final place has settled: the tolerance of a good touch


def least_period_s(height_um: float, speed_um_s: float, dwell_s: float) -> float:
    """Return the shortest time from jump to jump that shows how the tool settles."""
    return jump_time_s(height_um, speed_um_s, dwell_s) + LEAST_REST_S + BASE_S


def run_jumps(run: JobRun, depth_um: float, count: int) -> JumpSeries:
    """Go down to a displacement beside the work, and make `count` jumps by the profile's `[jump]`."""
    jump = run.profile.jump
    run.begin(Phase.APPROACHING)
    lower_to(run, depth_um)
    run.machine.rest(SETTLE_AT_DEPTH_S)
    start_um, start_v = run.watch.displacement_um, run.watch.actuator_v
    if start_um < jump.height_um:
        raise failures.jump_too_high(start_um=start_um, height_um=jump.height_um)
    run.begin(Phase.JUMPING)
    jumps = tuple(_jump(run, number) for number in range(1, count + 1))
    return JumpSeries(
        wanted_um=jump.height_um,
        speed_um_s=jump.speed_um_s,
        dwell_s=jump.dwell_s,
        period_s=jump.period_s,
        start_um=start_um,
        start_v=start_v,
        jumps=jumps,
        summary=_summary(jumps),
        time_s=run.machine.time_s,
    )


def _jump(run: JobRun, number: int) -> JumpMeasured:
    """Make one period of rest, jump and rest, and return what its samples show."""
    jump = run.profile.jump
    request, begin_s = jump_request(run, jump.height_um, 0.0), run.machine.time_s
    blocks: list[TelemetryBlock] = []
    run.watch.follow(blocks.append)
    try:
        run.machine.rest(BASE_S)
        run.machine.jump(request)
        left_s = begin_s + jump.period_s - run.machine.time_s
        run.machine.rest(min(max(LEAST_REST_S, left_s), LOOKED_AT_S))
    finally:
        run.watch.follow(None)
    run.watch.settle()
    found = _measured(run, number, joined(blocks))
    run.machine.rest(max(0.0, begin_s + jump.period_s - run.machine.time_s))
    back_um, model_um = signed(found.residual_um), signed(found.residual_model_um)
    run.decide(
        RunEvent.JUMP_MEASURED,
        f"Jump {number}: {found.height_um:.1f} µm high, back within {back_um} µm (model {model_um} µm), at rest "
        f"after {1e3 * found.settling_s:.0f} ms.",
        {"height_um": found.height_um, "residual_um": found.residual_um, "settling_s": found.settling_s},
    )
    return found


def _measured(run: JobRun, number: int, block: TelemetryBlock) -> JumpMeasured:
    time_s, sensor_um = block.time_s, block.displacement_um
    jumping = np.flatnonzero(block.state == MachineState.JUMP)
    if not len(jumping):
        raise failures.no_telemetry_of_jump(number=number)
    first, last = int(jumping[0]), int(jumping[-1])
    top = first + int(np.argmin(sensor_um[first : last + 1]))

    def both_um(where: NDArray[np.bool_]) -> tuple[float, float]:
        return float(sensor_um[where].mean()), run.watch.model_at(float(time_s[where].mean()))

    before_um, model_before_um = both_um(time_s < time_s[first])
    after_um, model_after_um = both_um(time_s > time_s[-1] - BASE_S)
    top_um, model_top_um = both_um(np.abs(time_s - time_s[top]) <= TOP_S / 2.0)
    return JumpMeasured(
        number=number,
        time_s=float(time_s[first]),
        height_um=before_um - top_um,
        height_model_um=model_before_um - model_top_um,
        residual_um=after_um - before_um,
        residual_model_um=model_after_um - model_before_um,
        settling_s=_settling_s(time_s[last + 1 :], sensor_um[last + 1 :], after_um),
    )


def _settling_s(time_s: Array, sensor_um: Array, rest_um: float) -> float:
    """Return the time until the smoothed displacement stays within `SETTLED_UM` of where it comes to rest."""
    period_s = float(np.median(np.diff(time_s)))
    width = max(1, round(SMOOTHED_S / period_s))
    smooth_um = np.convolve(sensor_um, np.full(width, 1.0 / width), mode="valid")
    away = np.flatnonzero(np.abs(smooth_um - rest_um) > SETTLED_UM)
    return float(time_s[away[-1] + width - 1] - time_s[0]) if len(away) else 0.0


def _summary(jumps: tuple[JumpMeasured, ...]) -> JumpSummary:
    heights = [jump.height_um for jump in jumps]
    residuals = [abs(jump.residual_um) for jump in jumps]
    errors = [abs(jump.residual_model_um - jump.residual_um) for jump in jumps]
    settling = [jump.settling_s for jump in jumps]
    number = len(jumps)
    return JumpSummary(
        height_mean_um=math.fsum(heights) / number,
        height_min_um=min(heights),
        height_max_um=max(heights),
        residual_mean_um=math.fsum(residuals) / number,
        residual_max_um=max(residuals),
        model_error_mean_um=math.fsum(errors) / number,
        model_error_max_um=max(errors),
        settling_mean_s=math.fsum(settling) / number,
        settling_max_s=max(settling),
    )
