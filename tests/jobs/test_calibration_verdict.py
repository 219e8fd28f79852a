"""The verdict of a calibration: the worst of all held-out and validation errors decides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.actuator import waveforms
from edmctl.actuator.identification import Identification, identify
from edmctl.actuator.model import ActuatorState
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures, Validation
from edmctl.errors import RecordError
from edmctl.jobs import calibrate as fit
from edmctl.jobs.corrections import choose
from edmctl.planning.rules.load import load_profile
from edmctl.profile.calibration import Calibration, Made, calibration_of
from edmctl.profile.setup import Setup
from tests.actuator.models import make_model

RATE_HZ = 200.0


@cache
def swings(frequency_hz: float, lag_s: float = 0.0, name: str = "") -> Record:
    """Full and smaller swings of a model behind a lag, which one rate cannot tell from a delay."""
    parts = [
        waveforms.sine(0.0, high_v, frequency_hz, 2, RATE_HZ).u_v[1:]
        for high_v in (150.0, 150.0, 60.0, 110.0, 90.0, 140.0, 150.0, 70.0, 120.0, 150.0)
    ]
    u_v = np.concatenate(parts)
    seen_v, at_v, follow = np.empty(len(u_v)), 0.0, 1.0 - np.exp(-1.0 / RATE_HZ / lag_s) if lag_s else 1.0
    for k, volts in enumerate(u_v):
        at_v += follow * (volts - at_v)
        seen_v[k] = at_v
    t_s = np.arange(len(u_v)) / RATE_HZ
    truth = make_model(creep=0.01)
    y_um = truth.predict(t_s, seen_v, ActuatorState.conditioned(truth, 0.0))
    return Record(t_s, u_v, y_um, None, name or f"{frequency_hz:g} Hz")


def plain(records: list[Record], delay_s: float | None = None) -> Identification:
    return identify(records, delay_s=delay_s, resamples=0, beyond_plays=False)


@pytest.fixture(autouse=True, scope="module")
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "identify", plain)
        yield


@pytest.fixture(scope="module")
def verified() -> fit.CalibrationReport:
    """A model of one rate, validated with another record of about that rate."""
    return fit.find([swings(1.0)], [swings(1.1, name="again.csv")], ("zero",), None)


def test_a_validation_file_above_the_limits_refuses_the_model() -> None:
    """It was accepted: held-out blocks of one rate do not show what another rate needs."""
    slow, fast = swings(1.0, 0.015), swings(8.0, 0.015)
    found = fit.find([slow], [fast], ("zero",), None)
    (file,) = found.files
    assert file.max_pct > 2.0
    (problem,) = found.identification.problems
    assert problem.startswith("8 Hz (--validate): ")
    assert "at another rate (8 Hz) than the fitted records (1 Hz): fit records of such rates too" in problem
    assert plain([slow]).accepted


def test_records_of_one_rate_are_accepted_for_it_only_until_another_verifies_the_model(
    verified: fit.CalibrationReport,
) -> None:
    faster = fit.find([swings(1.0)], [swings(5.0)], ("zero",), None).identification
    alone = plain([swings(1.0)])
    for found, is_restricted in ((alone, True), (verified.identification, True), (faster, False)):
        assert found.accepted, found.problems
        assert any("one rate" in one for one in found.restrictions) == is_restricted
        assert any("Hold a step" in one for one in found.restrictions)


figures = st.builds(
    ErrorFigures.of_range,
    max_um=st.floats(0.0, 20.0),
    rms_um=st.floats(0.0, 5.0),
    range_um=st.just(400.0),
)


@given(st.lists(figures, min_size=1, max_size=4))
def test_accepted_means_that_no_error_is_above_the_limits(
    verified: fit.CalibrationReport, errors: list[ErrorFigures]
) -> None:
    """Then the better of two models is never refused while the worse is accepted."""
    record = swings(1.0)
    judged = [(record, Validation(one, 1.0, 0.0, 0)) for one in errors]
    accepted = fit._verified(verified.identification, [record], judged).accepted
    assert accepted == all(one.rms_pct <= 0.5 and one.max_pct <= 2.0 for one in errors)


def test_the_verdict_of_validation_files_is_saved_and_verified_when_loaded(
    verified: fit.CalibrationReport, tmp_path: Path
) -> None:
    made = Made(utc="2026-01-01T00:00:00+00:00", edmctl="0", serial="SIM-1", simulated=True)
    path, files = tmp_path / "one.toml", [asdict(file) for file in verified.files]
    calibration = calibration_of(verified.identification, made, verified.held_out_baselines, files)
    calibration.save(path)
    kept = Calibration.load(path)
    assert kept == calibration
    assert kept.quality.validation is not None
    assert kept.quality.validation[0].name == "again.csv"
    assert kept.quality.validation[0].rms_pct == verified.files[0].rms_pct
    choice = choose(path, {}, Setup(), load_profile("cu270").profile, "SIM-1")
    assert [one.code for one in choice.warnings] == ["W8109"]
    assert "was accepted for this rate only: all records swing at one rate" in choice.warnings[0].message
    assert "check one with --validate. Accepted for use without holds only: the" in choice.warnings[0].message
    assert "accepted with restrictions" in choice.used.text
    worse = files[0] | {"max_um": 40.0, "max_pct": 4000.0 / verified.files[0].range_um}
    calibration_of(verified.identification, made, {}, [worse]).save(path)
    with pytest.raises(RecordError, match="accepted with errors of"):
        Calibration.load(path)
