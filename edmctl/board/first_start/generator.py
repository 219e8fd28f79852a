"""Part 4, pulses in the air: self-test, open voltage, gate, watchdog, measure mode."""

from __future__ import annotations

from statistics import median
from typing import Any, cast

from edmctl.board.first_start.checklist import (
    Cause,
    Checklist,
    Finding,
    Skip,
    check,
    mistake,
    wrong,
)
from edmctl.dataclasses import dataclass, field
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.interface import (
    ControllerSettings,
    CutRequest,
    MachineListener,
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
from edmctl.wording import decimal

GAP_PULSES = PulseSettings(100.0, 300.0, 40.0, 0.1, PulseMode.ISOFREQUENCY, 0.0)
DUTY = GAP_PULSES.on_time_us / (GAP_PULSES.on_time_us + GAP_PULSES.off_time_us)
OPEN_ERROR, NO_CURRENT_A = 0.05, 0.01
SPARKLESS_S, FIRST_S = 1.0, 0.2
"""Time of pulses, and what the filter of the gap voltage takes of it."""
CREEP_UM_S = 0.05
"""The slowest feed that a controller accepts: the tool hardly moves."""
CLEAR_UM = 20.0
WATCHDOG_SPARE_S, TOUCH_UM, TOUCH_UM_S = 0.1, 4.0, 5.0


@dataclass(slots=True)
class Recording(MachineListener):
    """Keeps samples."""

    blocks: list[TelemetryBlock] = field(default_factory=list)

    def telemetry(self, block: TelemetryBlock) -> None:
        self.blocks.append(block)

    @property
    def samples(self) -> TelemetryBlock:
        """All samples. Raises LinkLost if none came."""
        if not self.blocks:
            raise host_fault("SAMPLES_LOST")
        return joined(self.blocks)

    def counts(self) -> Any:
        """Return the pulses counted in each sample."""
        s = self.samples
        return sum(cast("Any", part).astype(int) for part in (s.n_open, s.n_normal, s.n_arc, s.n_short))

    def last_pulse_s(self) -> float:
        """Return the time at which the last sample with a pulse ends."""
        return float(self.samples.time_s[self.counts() > 0][-1])


def _configure(c: Checklist, rest_um: float) -> Recording:
    """Set a servo that hardly feeds, everything else at its default, and record samples."""
    motion = motion_settings(c.setup, rest_um + CLEAR_UM, sensor_fitted=c.setup.sensor.fitted, pulses=True)
    values: dict[str, Any] = {**default_settings(), **settings_by_name(motion)}
    values |= {"forward_um_s": CREEP_UM_S, "back_um_s": CREEP_UM_S, "open_lost_s": 60.0}
    settings = ControllerSettings(**{name: values[name] for name in ControllerSettings.__slots__})
    c.machine.configure(settings, GAP_PULSES)
    recording = Recording()
    period_us = 1000 * max(1, round(1000.0 / c.setup.controller.telemetry_hz))
    c.machine.start_telemetry(TelemetrySettings(period_us, 10, PulseLog.OFF), recording)
    c.machine.arm()
    return recording


def _start_pulses(c: Checklist) -> Recording:
    rest_um = c.resting_um()
    recording = _configure(c, rest_um)
    reference_v = 0.5 * DUTY * GAP_PULSES.open_voltage_v
    c.machine.start_cut(CutRequest(reference_v, rest_um + CLEAR_UM, 20.0))
    return recording


@check("self-test", share=OPEN_ERROR)
def self_test(c: Checklist) -> Finding:
    c.allow("generator")
    _configure(c, 0.0)
    expected_v = DUTY * GAP_PULSES.open_voltage_v
    try:
        on_v = c.machine.self_test()
    except MachineFault as error:
        if error.fault != FaultCode.GAP_SENSOR:
            raise
        c.machine.safe_stop()
        c.machine.clear_fault(error.fault)
        on_v = 1e-3 * error.detail
        read = f"gate on: {decimal(on_v)} V (expected {decimal(expected_v)}), fault {error.fault:d}"
        return Finding(read, (self_test_cause(on_v / expected_v),))
    c.machine.disarm()
    c.machine.stop_telemetry()
    off_v = float(default_settings()["test_error"]) * expected_v
    return Finding(
        f"gate off: less than {decimal(off_v)} V; gate on: {decimal(on_v)} V of {decimal(expected_v)} V"
    )


def self_test_cause(share: float) -> Cause:
    """Return the mistake if `share` of the expected voltage was read; the sensor has read a battery right.

    If that is right, the half with the gate off was not; the open voltage means no pulses at all.
    """
    if abs(share - 1.0) <= OPEN_ERROR or abs(share * DUTY - 1.0) <= OPEN_ERROR:
        return mistake("gate_shorted")
    return mistake("no_voltage") if share < 0.5 else mistake("self_test_scale", share=share)


@check("open-voltage", volts=GAP_PULSES.open_voltage_v, share=OPEN_ERROR, amperes=NO_CURRENT_A)
def open_voltage(c: Checklist) -> Finding:
    recording = _start_pulses(c)
    c.machine.rest(SPARKLESS_S)
    c.kept["pulses"] = recording, c.machine.stop_cut().time_s
    c.machine.rest(FIRST_S)
    c.machine.disarm()
    c.machine.stop_telemetry()
    s = recording.samples
    on = (s.flags & TelemetryFlag.PULSES_ON) != 0
    steady = on & (s.time_s > s.time_s[on][0] + FIRST_S)
    share = float(s.gap_v[steady].mean()) / DUTY / GAP_PULSES.open_voltage_v
    current_a = float(s.current_a[steady].max())
    n_open, others = int(s.n_open[on].sum()), int((recording.counts() - s.n_open)[on].sum())
    read = (
        f"{decimal(share * GAP_PULSES.open_voltage_v)} V, {n_open} open pulses and {others} others, "
        f"{1000.0 * current_a:.0f} mA at most"
    )
    causes = []
    if abs(share - 1.0) > OPEN_ERROR:
        causes.append(mistake("open_voltage_scale", share=share))
    if others or current_a > NO_CURRENT_A:
        causes.append(mistake("current_offset"))
    return Finding(read, tuple(causes))


@check("gate-off")
def gate_off(c: Checklist) -> Finding:
    """Times of samples are those of their ends: one and a half periods after the end no pulse is counted."""
    if "pulses" not in c.kept:
        raise Skip("needs: open voltage")
    recording, end_s = c.kept["pulses"]
    time_s = recording.samples.time_s
    period_s = float(median((time_s[1:] - time_s[:-1]).tolist()))
    late = int((recording.counts() * (time_s > end_s + 1.5 * period_s)).sum())
    after_ms = 1000.0 * (recording.last_pulse_s() - end_s)
    read = f"the last sample with a pulse ends {decimal(after_ms, 1)} ms after the generator, {late} pulses later"
    return wrong(read, "gate_stuck") if late else Finding(read)


@check("watchdog", seconds=WATCHDOG_SPARE_S)
def watchdog(c: Checklist) -> Finding:
    recording, watchdog_s = _start_pulses(c), c.setup.controller.watchdog_s
    c.machine.rest(SPARKLESS_S / 2.0)
    start_s = c.machine.time_s
    c.machine.fall_silent(2.0 * watchdog_s + WATCHDOG_SPARE_S)
    status = c.machine.readings()
    c.machine.safe_stop()
    last_s = recording.last_pulse_s() - start_s
    read = (
        f"state {status.state.name}, fault {status.fault or 'none'}, the last pulse {last_s:.2f} s after the "
        "silence began"
    )
    if status.fault:
        c.machine.clear_fault(status.fault)
    if status.fault == FaultCode.HOST_SILENT and last_s <= watchdog_s + WATCHDOG_SPARE_S:
        return Finding(read)
    return wrong(read, "host_not_watched")


@check("measure-mode", um=TOUCH_UM)
def measure_mode(c: Checklist) -> Finding:
    rest_um = c.resting_um()
    _configure(c, rest_um)
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
        return Finding("no contact, no pulse")
    c.machine.disarm()
    return wrong("contact in the air", "contact_in_air")
