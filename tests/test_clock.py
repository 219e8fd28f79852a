"""A clock, or the time of a file, that no calendar has."""

from __future__ import annotations

import time

import pytest

import edmctl
from edmctl.app import main
from edmctl.errors import PreconditionError
from edmctl.wording import iso_of, start_utc, utc_of


def test_a_clock_beyond_its_range_is_a_clear_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def late() -> float:
        raise OverflowError("timestamp too large to convert to C _PyTime_t")

    monkeypatch.setattr(time, "time", late)
    for call in (edmctl.connect, lambda: edmctl.calibrate_files("record.csv")):
        with pytest.raises(PreconditionError) as error:
            call()
        assert error.value.code == "E8096"
    assert main(["run", "list"]) == 8
    assert "error[E8096]" in capsys.readouterr().err


@pytest.mark.parametrize("time_s", [3e11, -1e13, float("inf"), float("nan"), 1e300])
def test_the_time_of_a_file_may_be_anything(time_s: float) -> None:
    assert iso_of(time_s) == ""
    assert iso_of(0.0) == "1970-01-01T00:00:00.000+00:00"


@pytest.mark.parametrize("text", ["0001-01-01T00:00:00+23:00", "9999-12-31T23:59:59-23:00", "never", ""])
def test_a_start_that_is_no_time_is_shown_as_it_is(text: str) -> None:
    assert utc_of(text) is None
    assert start_utc(text) in {text, "–"}
