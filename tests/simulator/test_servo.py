"""The gap servo of the virtual controller: sign, limit cycle, PI law, and what a slow relay does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.process.erosion import GapLaw
from edmctl.simulator import BenchConfig, DischargeConstants
from edmctl.simulator.injection import parse_injection
from tests.simulator.conftest import Rig, RigMaker

DUTY_V = 12.0


def servo_record(rig: Rig, seconds: float, **params: float) -> None:
    """Spark for some seconds under the servo with 1 ms telemetry."""
    rig.arm(params)
    rig.to_pad()
    rig.start_sparking()
    rig.session.pump(3.0)
    rig.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    rig.session.pump(seconds)


def test_the_servo_advances_in_an_open_gap_and_backs_out_of_a_short(rig: RigMaker) -> None:
    r = rig()
    servo_record(r, 10.0)
    gap_v, z, flags = r.column("gap_v"), r.column("displacement_um"), r.column("flags").astype(int)
    advancing = (flags & m.TlmFlags.ADVANCING) > 0
    assert gap_v[advancing].mean() > gap_v[~advancing].mean()
    assert gap_v.mean() == pytest.approx(0.8 * 12.0, rel=0.03)
    assert z[-1000:].mean() > z[:1000].mean() + 1.0


def test_a_short_that_lasts_is_left_four_times_as_fast_after_half_a_second(rig: RigMaker) -> None:
    r = rig()
    r.bench.inject(parse_injection("WIRE_SHORT@sparks+4"))
    servo_record(r, 3.0, short_back_um_s=2.0)
    shorted = (r.column("flags").astype(int) & m.TlmFlags.SHORTED) > 0
    began = np.flatnonzero(~shorted)[-1] + 1  # bridges before it come and go
    v = r.column("actuator_v")[began:]
    slow_v_s, fast_v_s = (v[400] - v[100]) / 0.3, (v[900] - v[600]) / 0.3
    assert slow_v_s < 0.0
    assert fast_v_s == pytest.approx(4.0 * slow_v_s, rel=0.05)


def test_limit_cycle_has_the_period_and_size_of_theory(rig: RigMaker) -> None:
    """Relay with an integrator and dead time L: period 4L; S = 20 µm/s and a 50 ms loop."""
    r = rig()
    servo_record(r, 60.0, forward_um_s=20.0, back_um_s=20.0, short_back_um_s=20.0, servo_period_us=50_000)
    direction = (r.column("flags").astype(int) & m.TlmFlags.ADVANCING) > 0
    rises = np.count_nonzero(~direction[:-1] & direction[1:])
    period_s = direction.size * 1e-3 / rises
    loop_delay_s = 1.5 * 0.050 + 1.0 / (2.0 * np.pi * 20.0) + 0.002
    assert period_s == pytest.approx(4.0 * loop_delay_s, rel=0.25)
    # Half-amplitude S × L with the slope that the tool itself shows; a triangle's rms is that over √3.
    z = r.column("displacement_um")
    smooth = np.convolve(z, np.ones(25) / 25.0, "valid")
    slope_um_s = np.median(np.abs(smooth[25:] - smooth[:-25])) / 0.025
    drift = np.polyval(np.polyfit(np.arange(smooth.size), smooth, 5), np.arange(smooth.size))
    assert (smooth - drift).std() == pytest.approx(slope_um_s * loop_delay_s / np.sqrt(3.0), rel=0.35)


def test_a_slow_steep_relay_shorts_more_than_five_percent(rig: RigMaker) -> None:
    """20 µm/s of the tool itself with a 100 ms loop: the profile's rules refuse it, and this is why.

    In small loops the actuator gives about half its mean µm per V, hence the gain.
    """
    r = rig()
    servo_record(
        r,
        60.0,
        forward_um_s=20.0,
        back_um_s=20.0,
        short_back_um_s=20.0,
        servo_period_us=100_000,
        gain_um_per_v=1.5,
    )
    counts = {name: r.column(f"n_{name}").sum() for name in ("open", "normal", "arc", "short")}
    assert counts["short"] / sum(counts.values()) > 0.05


def test_default_servo_shorts_less_than_one_percent(rig: RigMaker) -> None:
    r = rig()
    servo_record(r, 60.0)
    counts = {name: r.column(f"n_{name}").sum() for name in ("open", "normal", "arc", "short")}
    assert counts["short"] / sum(counts.values()) < 0.01
    assert 0.2 < counts["open"] / sum(counts.values()) < 0.4


def test_slow_pulses_leave_the_filter_and_the_timers_in_seconds(rig: RigMaker) -> None:
    """At 200 Hz four of five milliseconds have no pulse; a 5 Hz low-pass still has a time constant of 32 ms."""
    r = rig().arm({"filter_hz": 5.0, "open_lost_s": 2.0})
    r.session.request(m.PulseConfig(1500.0, 3500.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    r.session.request(m.ServoStart(0.8 * DUTY_V, 500.0, 100.0))  # over the parking place: every pulse is open
    r.session.pump(0.4)
    gap_v = r.column("gap_v")
    sparking = gap_v[gap_v > 0.0]
    rise = (DUTY_V - sparking) / (DUTY_V - sparking[0])
    assert np.argmax(rise < math.exp(-1.0)) == pytest.approx(32, abs=6)
    assert r.wait_fault(4.0).t_us * 1e-6 == pytest.approx(2.0, abs=0.2)


def test_pi_law_holds_the_reference_too(rig: RigMaker) -> None:
    r = rig()
    servo_record(r, 30.0, servo_law=m.ServoLaw.PI)
    assert r.column("gap_v").mean() == pytest.approx(0.8 * 12.0, rel=0.03)


def test_a_jump_clears_the_gap_and_comes_back(rig: RigMaker) -> None:
    dirty = BenchConfig(discharge=DischargeConstants(gap=GapLaw(flush_time_s=10.0)))
    r = rig(dirty)
    servo_record(r, 40.0)
    before = r.column("displacement_um")[-200:].mean()
    debris = r.bench.plant.state.debris_um3
    r.session.request(m.Jump(60.0, 2000.0, 0.02, 2.0))
    r.wait(m.EventCode.JUMP_DONE, 5.0)
    assert r.bench.plant.state.debris_um3 < 0.5 * debris
    r.samples.clear()
    r.session.pump(2.0)
    assert r.column("displacement_um")[-200:].mean() == pytest.approx(before, abs=3.0)
    assert r.bench.controller.state is m.State.MACHINING
