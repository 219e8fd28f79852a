"""Parameters of the virtual controller: staged by SET_PARAM, current after COMMIT_PROFILE."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.link.messages import PARAMS, param_crc
from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from edmctl.simulator.plant import Plant

TICK_US = 1000  # this controller decides on whole milliseconds
FULL_SCALE_V = 150.0  # what track_error is a share of
DISPLACEMENT_FILTER_S = 0.05  # low-pass of the sensor for depth limits

_FLOATS = {
    "piezo_max_v": k.PIEZO_MAX,
    "slew_limit_v_s": k.SLEW_LIMIT,
    "forward_um_s": k.FORWARD,
    "back_um_s": k.BACK,
    "short_back_um_s": k.SHORT_BACK,
    "hysteresis": k.HYSTERESIS,
    "kp_um_s": k.KP,
    "ki_um_s2": k.KI,
    "short_v": k.SHORT_BELOW,
    "arc_v": k.ARC_BELOW,
    "arc_delay_us": k.ARC_DELAY,
    "open_lost_um": k.OPEN_LOST,
    "monitor_min_v": k.MONITOR_MIN,
    "monitor_max_v": k.MONITOR_MAX,
    "over_current": k.OVER_CURRENT,
}
_BY_ID = {param.id: param for param in PARAMS.values()}


class Parameters:
    """The parameter set of one controller."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._values: dict[str, float] = {}
        self._staged: dict[str, float] = {}
        self.reset()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def stage(self, param_id: int, wire_value: int) -> bool:
        """Stage a value; False for an unknown parameter or a value out of range or off its grid."""
        param = _BY_ID.get(param_id)
        if param is None:
            return False
        value = param.from_wire(wire_value)
        if not param.minimum <= value <= param.maximum:
            return False
        if param.name == "servo_period_us" and wire_value % TICK_US:
            return False
        self._staged[param.name] = value
        return True

    def wire_value(self, param_id: int) -> int | None:
        """Current value as SET_PARAM would carry it; None for an unknown parameter."""
        param = _BY_ID.get(param_id)
        return None if param is None else param.to_wire(self._values[param.name])

    def commit(self, crc: int) -> bool:
        """Make the staged values current if their check agrees."""
        if param_crc(self._staged) != crc:
            self._staged = dict(self._values)
            return False
        self._values = dict(self._staged)
        self.crc = crc
        self._apply()
        return True

    def reset(self) -> None:
        """Make every parameter its default, as after a reset."""
        self._values = {name: param.default for name, param in PARAMS.items()}
        self._staged = dict(self._values)
        self.crc = param_crc(self._values)
        self._apply()

    def _apply(self) -> None:
        par, ist, v = self._plant.par, self._plant.ist, self._values
        for name, index in _FLOATS.items():
            par[index] = v[name]
        par[k.V_PER_UM] = 1.0 / v["gain_um_per_v"]
        par[k.SENSOR_MISSING] = 1.0 - v["sensor_fitted"]
        par[k.FILTER_ALPHA] = 1.0 - math.exp(-2.0 * math.pi * v["filter_hz"] * k.TICK_S)
        par[k.DISPLACEMENT_ALPHA] = 1.0 - math.exp(-k.TICK_S / DISPLACEMENT_FILTER_S)
        par[k.TRACK_V] = v["track_error"] * FULL_SCALE_V
        ist[k.TRACK_TICKS_MAX] = max(1, round(v["track_s"] / k.TICK_S))
        ist[k.MISREADS_MAX] = int(v["misread_pulses"])
        self.bad_frames = int(v["bad_frames"])
        self.test_error = v["test_error"]
        self.retract_v_s = v["retract_v_s"]
        self.watchdog_ticks = round(v["watchdog_s"] / k.TICK_S)
        self.dielectric_required = bool(v["dielectric_required"])
        self.flow_min_lpm = v["flow_min_lpm"]
        self.temperature_max_c = v["temperature_max_c"]
        ist[k.LAW] = int(v["servo_law"])
        ist[k.SERVO_TICKS] = max(1, round(v["servo_period_us"] / 1000.0))
        ist[k.SERVO_LATENCY] = int(v["servo_latency"])
        ist[k.BLOCK_SIZE] = int(v["block_pulses"])
        ist[k.SHORT_TICKS_MAX] = round(v["short_stuck_s"] / k.TICK_S)
        ist[k.ARC_RUN_MAX] = int(v["arc_run"])
        ist[k.OPEN_TICKS_MAX] = round(v["open_lost_s"] / k.TICK_S)
