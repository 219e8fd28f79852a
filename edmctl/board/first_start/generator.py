"""Pulses in the air: self-test, open voltage, gate, watchdog, measure mode."""

from __future__ import annotations

from functools import partial
from statistics import median
from typing import Any, cast

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import Checklist, Found, Spec, mean, wrong
from edmctl.board.first_start.nets import cause
from edmctl.board.results import Cause
from edmctl.dataclasses import dataclass, field
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.interface import (
    ControllerSettings,
    CutRequest,
    MachineEvent,
    MachineListener,
    MotionSettings,
    PulseLog,
    PulseMode,
    PulseSettings,
    TelemetryBlock,
    TelemetryFlag,
    TelemetrySettings,
    TouchRequest,
    default_settings,
    host_fault,
    joined,
    settings_by_name,
)
from edmctl.procedures.settings import motion_settings
from edmctl.profile.setup import Setup
from edmctl.wording import decimal

PART = "generator"
GAP_PULSES = PulseSettings(100.0, 300.0, 40.0, 0.1, PulseMode.ISOFREQUENCY, 0.0)
OPEN_ERROR, NO_CURRENT_A = 0.05, 0.01
SPARKLESS_S, FIRST_S = 1.0, 0.2
"""Time of pulses, and what the filter of the gap voltage takes of it."""
CREEP_UM_S = 0.05
"""The slowest feed that a controller takes: a tool that hardly moves."""
CLEAR_UM = 20.0
OFF_SAMPLES = 10
"""Of the half of the self-test that has the generator off, its end."""
WATCHDOG_SPARE_S = 0.1
TOUCH_UM, TOUCH_UM_S = 4.0, 5.0

SELF_TEST = Spec(
    "self-test",
    "self-test of the gap sensor",
    "The generator was off for 0.1 s and on for 0.2 s, tool at 0 V.",
    f"off none; on duty x open voltage within {100.0 * OPEN_ERROR:.0f} %",
    ("range", "gap-rest", "gap-battery"),
)
OPEN = Spec(
    "open-voltage",
    "open voltage",
    "The generator was on for 1 s.",
    f"{GAP_PULSES.open_voltage_v:g} V within {100.0 * OPEN_ERROR:.0f} %, every pulse open, below "
    f"{1000.0 * NO_CURRENT_A:.0f} mA",
    ("self-test",),
)
GATE_OFF = Spec(
    "gate-off",
    "gate off",
    "The generator was switched off.",
    "no pulse in a later sample",
    ("self-test",),
)
WATCHDOG = Spec(
    "watchdog",
    "watchdog",
    "The generator was on, and this program fell silent.",
    f"pulses off within the watchdog's time and {WATCHDOG_SPARE_S:g} s, fault 1001",
    ("self-test",),
)
MEASURE = Spec(
    "measure-mode",
    "measure mode",
    f"A touch in the air, {TOUCH_UM:g} µm far.",
    "no contact (fault 2005), no pulse",
    ("self-test",),
)


def look(c: Checklist) -> None:
    """Let the generator make pulses with the tool far from the work."""
    c.part = PART
    c.item(SELF_TEST, partial(_self_test, c))
    heard = Heard()
    if c.item(OPEN, partial(_open_voltage, c, heard)) or heard.end is not None:
        c.item(GATE_OFF, partial(_gate_off, heard))
    else:
        c.skip(GATE_OFF, "needs: open voltage")
    c.item(WATCHDOG, partial(_watchdog, c))
    c.item(MEASURE, partial(_measure_mode, c))


def _self_test(c: Checklist) -> Found:
    c.allow("generator")
    heard = Heard()
    c.machine.configure(_pulsing(c.setup, 0.0), GAP_PULSES)
    c.machine.start_telemetry(TelemetrySettings(_period_us(c.setup), 10, PulseLog.OFF), heard)
    c.machine.arm()
    meant_v = _duty() * GAP_PULSES.open_voltage_v
    try:
        on_v = c.machine.self_test()
    except MachineFault as error:
        if error.fault != FaultCode.GAP_SENSOR:
            raise
        c.machine.safe_stop()
        c.machine.clear_fault(error.fault)
        on_v = 1e-3 * error.detail
        read = f"gate on: {decimal(on_v)} V (expected {decimal(meant_v)}), fault {error.fault:d}"
        if _is_stuck_on(on_v / meant_v):
            read = f"gate off: {_off_in_words(heard)} (expected 0); {read}"
        return Found(read, (_self_test_cause(on_v / meant_v),))
    c.machine.disarm()
    c.machine.stop_telemetry()
    off_v = float(default_settings()["test_error"]) * meant_v
    return Found(
        f"gate off: less than {decimal(off_v)} V; gate on: {decimal(on_v)} V of {decimal(meant_v)} V"
    )


def _is_stuck_on(share: float) -> bool:
    """Whether a self-test that has failed was wrong with the gate off, by the `share` of what was meant with it on.

    Either that is right, so that the other half is not; or it is the open voltage, without any pulses.
    """
    return abs(share - 1.0) <= OPEN_ERROR or abs(share * _duty() - 1.0) <= OPEN_ERROR


def _off_in_words(heard: Heard) -> str:
    """The gap voltage before the generator was on, from the samples."""
    if heard.blocks:
        s = heard.samples
        n_off = int(((s.flags & TelemetryFlag.PULSES_ON) == 0).argmin())
        if n_off >= OFF_SAMPLES:
            return f"{decimal(float(s.gap_v[n_off - OFF_SAMPLES : n_off].mean()), 1)} V"
    return "a voltage"


def _self_test_cause(share: float) -> Cause:
    """`share` of the expected voltage was read with the generator on; the sensor read a battery right."""
    if _is_stuck_on(share):
        return cause(
            "voltage at the gap with the generator there and its gate off: the transistor is shorted, or its "
            "driver stuck on; switch the supply off",
            nets.GATE,
        )
    if share < 0.5:
        return cause(
            "the driver makes pulses, and no voltage comes to the gap: the mode switch stays at the contact "
            "circuit (its wire is off), the supply is not enabled, or its set point is off",
            nets.MODE,
            nets.ALIVE,
            nets.OPEN_VOLTAGE,
        )
    return cause(f"{share:.2f} of the voltage set comes: scale of the setting", nets.OPEN_VOLTAGE)


def _duty() -> float:
    return GAP_PULSES.on_time_us / (GAP_PULSES.on_time_us + GAP_PULSES.off_time_us)


def _pulsing(setup: Setup, rest_um: float) -> ControllerSettings:
    """Return parameters of a servo that hardly feeds, everything else at its default."""
    motion: MotionSettings = motion_settings(
        setup, rest_um + CLEAR_UM, sensor_fitted=setup.sensor.fitted, pulses=True
    )
    values: dict[str, Any] = {**default_settings(), **settings_by_name(motion)}
    values |= {"forward_um_s": CREEP_UM_S, "back_um_s": CREEP_UM_S, "open_lost_s": 60.0}
    return ControllerSettings(**{name: values[name] for name in ControllerSettings.__slots__})


@dataclass(slots=True)
class Heard(MachineListener):
    """A listener that keeps samples; `end` is when the generator was switched off."""

    blocks: list[TelemetryBlock] = field(default_factory=list)
    end: MachineEvent | None = None

    def telemetry(self, block: TelemetryBlock) -> None:
        """Keep."""
        self.blocks.append(block)

    @property
    def samples(self) -> TelemetryBlock:
        """All samples. Raises LinkLost where none came."""
        if not self.blocks:
            raise host_fault("SAMPLES_LOST")
        return joined(self.blocks)

    def pulses_in(self) -> Any:
        """Pulses counted in each sample."""
        s = self.samples
        return sum(cast("Any", part).astype(int) for part in (s.n_open, s.n_normal, s.n_arc, s.n_short))


def _period_us(setup: Setup) -> int:
    return 1000 * max(1, round(1000.0 / setup.controller.telemetry_hz))


def _begin_pulses(c: Checklist, heard: Heard) -> None:
    rest_um = mean([status.displacement_um for status in c.read()]) if c.setup.sensor.fitted else 0.0
    c.machine.configure(_pulsing(c.setup, rest_um), GAP_PULSES)
    c.machine.start_telemetry(TelemetrySettings(_period_us(c.setup), 10, PulseLog.OFF), heard)
    c.machine.arm()
    reference_v = 0.5 * _duty() * GAP_PULSES.open_voltage_v
    c.machine.start_cut(CutRequest(reference_v, rest_um + CLEAR_UM, 20.0))


def _open_voltage(c: Checklist, heard: Heard) -> Found:
    _begin_pulses(c, heard)
    c.machine.rest(SPARKLESS_S)
    heard.end = c.machine.stop_cut()
    c.machine.rest(FIRST_S)
    c.machine.disarm()
    c.machine.stop_telemetry()
    s = heard.samples
    on = (s.flags & TelemetryFlag.PULSES_ON) != 0
    settled = on & (s.time_s > s.time_s[on][0] + FIRST_S)
    open_v = float(s.gap_v[settled].mean()) / _duty()
    current_a = float(s.current_a[settled].max())
    n_open, others = int(s.n_open[on].sum()), int((heard.pulses_in() - s.n_open)[on].sum())
    read = (
        f"{decimal(open_v)} V, {n_open} open pulses and {others} others, {1000.0 * current_a:.0f} mA at most"
    )
    causes = []
    if abs(open_v / GAP_PULSES.open_voltage_v - 1.0) > OPEN_ERROR:
        text = f"the open voltage is {open_v / GAP_PULSES.open_voltage_v:.2f} of the one set: scale of the setting"
        causes.append(cause(text, nets.OPEN_VOLTAGE))
    if others or current_a > NO_CURRENT_A:
        text = "current without a discharge: offset of the current sensor or of its comparator; or the tool touches"
        causes.append(cause(text, nets.CURRENT, nets.IGNITION))
    return Found(read, tuple(causes))


def _gate_off(heard: Heard) -> Found:
    assert heard.end is not None
    s = heard.samples
    late = heard.pulses_in() * (s.time_s > heard.end.time_s + _span_s(s))
    last_s = float(s.time_s[heard.pulses_in() > 0][-1]) - heard.end.time_s
    read = f"the last pulse {_apart(last_s)} the generator was switched off, {int(late.sum())} pulses later"
    if not late.any():
        return Found(read)
    return wrong(read, "pulses go on while the gate is off: gate or driver stuck", nets.GATE)


def _apart(after_s: float) -> str:
    """When the sample with the last pulse ends, relative to the generator being switched off."""
    after_ms = round(1000.0 * after_s, 1)
    if after_ms == 0.0:
        return "in the sample that ends when"
    return f"in the sample that ends {abs(after_ms):.1f} ms {'after' if after_ms > 0.0 else 'before'}"


def _span_s(samples: TelemetryBlock) -> float:
    """One and a half sample periods: the times are those of the ends."""
    return 1.5 * float(median((samples.time_s[1:] - samples.time_s[:-1]).tolist()))


def _watchdog(c: Checklist) -> Found:
    heard, watchdog_s = Heard(), c.setup.controller.watchdog_s
    _begin_pulses(c, heard)
    c.machine.rest(SPARKLESS_S / 2.0)
    begun_s = c.machine.time_s
    c.machine.fall_silent(2.0 * watchdog_s + WATCHDOG_SPARE_S)
    status = c.machine.readings()
    c.machine.safe_stop()
    s = heard.samples
    last_s = float(s.time_s[heard.pulses_in() > 0][-1]) - begun_s
    read = (
        f"state {status.state.name}, fault {status.fault or 'none'}, the last pulse {last_s:.2f} s after the "
        "silence began"
    )
    is_right = status.fault == FaultCode.HOST_SILENT and last_s <= watchdog_s + WATCHDOG_SPARE_S
    if status.fault:
        c.machine.clear_fault(status.fault)
    if is_right:
        return Found(read)
    return wrong(read, "the firmware does not stop without its host: flash the right image", "firmware")


def _measure_mode(c: Checklist) -> Found:
    rest_um = mean([status.displacement_um for status in c.read()]) if c.setup.sensor.fitted else 0.0
    c.machine.configure(_pulsing(c.setup, rest_um), GAP_PULSES)
    c.machine.arm()
    try:
        c.machine.touch(
            TouchRequest(
                fast_um_s=TOUCH_UM_S,
                fast_to_um=rest_um,
                speed_um_s=TOUCH_UM_S,
                z_max_um=rest_um + TOUCH_UM,
                back_off_um=TOUCH_UM,
                dwell_s=0.1,
                touches=1,
            )
        )
    except MachineFault as error:
        if error.fault != FaultCode.NO_CONTACT:
            raise
        c.machine.safe_stop()
        c.machine.clear_fault(error.fault)
        return Found("no contact, no pulse")
    c.machine.disarm()
    return wrong("contact in the air", "the contact closes in the air", nets.CONTACT)
