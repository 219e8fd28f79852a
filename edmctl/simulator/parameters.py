"""Parameters of the virtual controller: staged by SET_PARAM, current after COMMIT_PROFILE."""

from __future__ import annotations

import math

from edmctl.link.messages import PARAMS, param_crc
from edmctl.simulator.controller_state import Settings
from edmctl.simulator.plant_interface import TICK_S

TICK_US = 1000  # this controller decides on whole milliseconds
FULL_SCALE_V = 150.0  # what track_error is a share of
DISPLACEMENT_FILTER_S = 0.05  # low-pass of the sensor for depth limits

_BY_ID = {param.id: param for param in PARAMS.values()}


class Parameters:
    """The parameter set of one controller."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
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
        settings, v = self._settings, self._values
        for name in PARAMS.keys() & settings.numbers().keys():
            setattr(settings, name, v[name])
        settings.v_per_um = 1.0 / v["gain_um_per_v"]
        settings.sensor_missing = 1 - int(v["sensor_fitted"])
        settings.filter_alpha = 1.0 - math.exp(-2.0 * math.pi * v["filter_hz"] * TICK_S)
        settings.displacement_alpha = 1.0 - math.exp(-TICK_S / DISPLACEMENT_FILTER_S)
        settings.track_v = v["track_error"] * FULL_SCALE_V
        settings.track_ticks_max = max(1, round(v["track_s"] / TICK_S))
        settings.misreads_max = int(v["misread_pulses"])
        settings.law = int(v["servo_law"])
        settings.servo_ticks = max(1, round(v["servo_period_us"] / 1000.0))
        settings.latency_decisions = int(v["servo_latency"])
        settings.block_size = int(v["block_pulses"])
        settings.short_ticks_max = round(v["short_stuck_s"] / TICK_S)
        settings.arc_run_max = int(v["arc_run"])
        settings.open_ticks_max = round(v["open_lost_s"] / TICK_S)
        self.bad_frames = int(v["bad_frames"])
        self.test_error = v["test_error"]
        self.retract_v_s = v["retract_v_s"]
        self.watchdog_ticks = round(v["watchdog_s"] / TICK_S)
        self.dielectric_required = bool(v["dielectric_required"])
        self.flow_min_lpm = v["flow_min_lpm"]
        self.temperature_max_c = v["temperature_max_c"]
