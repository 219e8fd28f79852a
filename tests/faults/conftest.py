"""Fixtures of the faults' tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from edmctl.profile.calibration import Made, calibration_of
from tests.procedures.conftest import identified


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibration file of the virtual machine with seed 1."""
    made = Made(utc="2026-01-01T00:00:00Z", edmctl="0.1.0", serial="SIM-1", simulated=True)
    path = tmp_path_factory.mktemp("calibration") / "one.toml"
    calibration_of(identified(1), made).save(path)
    return path
