"""What the controller is told, derived from recipe and setup."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.link.messages import PARAMS, PulseLog, PulseMode, ServoLaw
from edmctl.machine.interface import settings_by_name
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.session import running
from edmctl.procedures.settings import (
    controller_settings,
    gap_reference_v,
    pulse_settings,
    recorded_every,
    telemetry_settings,
)
from edmctl.profile.model import Profile
from edmctl.profile.setup import Setup
from tests.tiers import tiers

from .conftest import CU270, Shop


def profile(*overrides: str) -> Profile:
    return load_profile(CU270, overrides).profile


def test_thresholds_follow_the_voltages_and_protection_is_as_tight_as_the_runs_of_the_decision_allow() -> (
    None
):
    settings = controller_settings(profile(), Setup())
    assert settings.short_v == pytest.approx(6.0)
    assert settings.arc_v == pytest.approx(19.5, abs=0.01)
    raised = controller_settings(profile("pulse.open_voltage_v=60.0", "servo.reference=0.85"), Setup())
    assert raised.short_v == pytest.approx(9.0)
    assert (settings.short_stuck_s, settings.arc_run, settings.open_lost_s) == (1.5, 20, 3.0)
    # A stuck short has been retracted by far more than the 100 µm that any bridge is high.
    assert 4.0 * settings.short_back_um_s * (settings.short_stuck_s - 0.5) >= 200.0


def test_every_setting_of_every_shipped_recipe_fits_the_wire() -> None:
    for name in ("cu270", "cu150", "w252"):
        settings = controller_settings(load_profile(CU270.replace("cu270", name)).profile, Setup())
        for key, value in settings_by_name(settings).items():
            PARAMS[key].to_wire(value)


def test_servo_generator_and_log_are_the_recipes() -> None:
    settings = controller_settings(profile('servo.mode="pi"', "servo.kp=12.0"), Setup())
    assert (settings.servo_law, settings.kp_um_s) == (ServoLaw.PI, 12.0)
    assert gap_reference_v(profile("servo.reference=0.82")) == pytest.approx(0.82 * 12.0)
    pulses = pulse_settings(profile())
    assert pulses.on_time_us == pytest.approx(130.43, abs=0.01)
    assert pulses.on_time_us + pulses.off_time_us == pytest.approx(1e6 / 2300)
    assert pulses.mode is PulseMode.ISOFREQUENCY
    for name, log in (("off", PulseLog.OFF), ("blocks", PulseLog.BLOCKS), ("full", PulseLog.FULL)):
        assert telemetry_settings(profile(f'log.pulses="{name}"'), Setup()).pulse_log is log


@pytest.mark.parametrize(
    ("hz", "period_us", "batch", "every"),
    [
        (100.0, 10_000, 10, 1),
        (1000.0, 1000, 14, 1),
        (1.0, 10_000, 10, 100),
        (5.0, 10_000, 10, 20),
        (20.0, 10_000, 10, 5),
        (22.0, 9000, 11, 5),
        (60.0, 8000, 12, 2),
        (333.0, 3000, 14, 1),
    ],
)
def test_telemetry_runs_at_a_multiple_of_the_logged_rate_that_a_job_can_do_with(
    hz: float, period_us: int, batch: int, every: int
) -> None:
    recipe = profile(f"log.servo_hz={hz}")
    telemetry = telemetry_settings(recipe, Setup())
    assert (telemetry.period_us, telemetry.batch) == (period_us, batch)
    assert recorded_every(recipe, Setup()) == every


def test_no_sample_holds_more_pulses_than_its_counts_can() -> None:
    recipe = profile().model_copy(
        update={"pulse": profile().pulse.model_copy(update={"frequency_hz": 50_000.0})}
    )
    telemetry = telemetry_settings(recipe, Setup())
    assert 50_000 * telemetry.period_us * 1e-6 <= 250
    assert controller_settings(recipe, Setup()).block_pulses == 250


@pytest.mark.parametrize("hz", tiers(1.0, slow=(5.0, 20.0, 30.0)))
def test_a_log_with_few_rows_leaves_the_job_its_samples(hz: float) -> None:
    """Conditioning over a small stroke is short, and identifies the actuator from 200 samples or more."""
    shop = Shop((f"log.servo_hz={hz}", "limits.stroke_v_max=70"))
    with running(
        shop.machine, shop.job, shop.tally, recorder=shop.seen, observer=shop.told, pulses=False
    ) as run:
        assert run.watch.estimator() is not None
    times_s = shop.seen.column("time_s")
    assert np.diff(times_s) == pytest.approx(1.0 / hz, rel=0.1)
