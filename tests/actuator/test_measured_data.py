"""Measured records of a real stack actuator, kept outside the project.

EDMCTL_MEASURED names a folder with `mixed_amplitude_1hz.csv` and `full_range_1hz.csv` (PICMA P-885, 200 Hz).
"""

import os
from pathlib import Path

import numpy as np
import pytest

from edmctl.actuator.identification import Identification, identify
from edmctl.actuator.record import Record
from edmctl.actuator.validation import validate

FOLDER = Path(os.environ.get("EDMCTL_MEASURED", "absent"))
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="EDMCTL_MEASURED names no folder")


def read(name: str, first_s: float = 0.0, last_s: float = np.inf) -> Record:
    t_s, u_v, y_um = np.loadtxt(FOLDER / name, delimiter=",", skiprows=1, usecols=(0, 1, 2)).T
    inside = (t_s >= first_s) & (t_s < last_s)
    return Record(t_s[inside], u_v[inside], y_um[inside], name=name)


BARS_PCT = {"mixed_amplitude_1hz.csv": (1.26, 0.32), "full_range_1hz.csv": (1.71, 0.41)}
"""Largest and RMS error of the rest of the record that is fitted, and of another."""


@pytest.fixture(scope="module")
def found() -> Identification:
    return identify([read("mixed_amplitude_1hz.csv", 2.0, 33.0)])


def test_the_record_is_accepted(found: Identification) -> None:
    assert found.accepted, found.problems


@pytest.mark.parametrize(
    ("name", "first_s"), [("mixed_amplitude_1hz.csv", 33.0), ("full_range_1hz.csv", 0.0)]
)
def test_held_out_records_are_predicted(found: Identification, name: str, first_s: float) -> None:
    errors = validate(found.model, read(name, first_s)).errors
    most_pct, rms_pct = BARS_PCT[name]
    assert round(errors.max_pct, 2) <= most_pct
    assert round(errors.rms_pct, 2) <= rms_pct


def test_the_whole_record_is_accepted_too() -> None:
    found = identify([read("mixed_amplitude_1hz.csv")], resamples=0)
    assert found.accepted, found.problems
    assert validate(found.model, read("full_range_1hz.csv")).errors.rms_pct <= 0.41
