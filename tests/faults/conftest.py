"""Fixtures of the faults' tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.actuator.identification import identify
from edmctl.actuator.record import Record
from edmctl.actuator.waveforms import sampled, slow_legs
from edmctl.profile.calibration import Made, calibration_of
from edmctl.simulator.actuator import VirtualActuator

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibration file of the virtual machine with seed 1, identified at 50 Hz from the slow legs."""
    waveform = sampled(slow_legs(150.0), 1000.0)
    driven = VirtualActuator(1).drive(waveform.u_v)
    thin = slice(None, None, 20)
    record = Record(waveform.t_s[thin], driven.applied_v[thin], driven.sensor_um[thin])
    found = identify([record], delay_s=0.0, folds=2, resamples=1)
    made = Made(utc="2026-01-01T00:00:00Z", edmctl="0.1.0", serial="SIM-1", simulated=True)
    path = tmp_path_factory.mktemp("calibration") / "one.toml"
    calibration_of(found, made).save(path)
    return path
