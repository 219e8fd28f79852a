"""Which calibration `machine` and `simulate` go by, what they say of it, and a machine without a sensor."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from edmctl.actuator.identification import identify
from edmctl.actuator.record import Record
from edmctl.actuator.waveforms import sampled, slow_legs
from edmctl.jobs.actuator_trial import Waveform, run_trial
from edmctl.jobs.corrections import reaches_down, reaches_up
from edmctl.jsonout import to_json_value
from edmctl.profile.calibration import Calibration, Made, calibration_of
from edmctl.profile.folders import kept_path
from edmctl.record.columns import write_columns
from edmctl.simulator.plant import VirtualActuator
from tests.cli.commands import SHALLOW, Here, Said
from tests.golden import once

NO_SENSOR = "[sensor]\nfitted = false\n"


def calibrate(path: Path, seed: int, high_v: float = 150.0) -> Path:
    """Write the calibration of a virtual machine, from the slow legs at 50 Hz; a part of the stroke plainly."""
    waveform = sampled(slow_legs(high_v), 1000.0)
    driven = VirtualActuator(seed).drive(waveform.u_v)
    thin = slice(None, None, 20)
    record = Record(waveform.t_s[thin], driven.applied_v[thin], driven.sensor_um[thin])
    found = identify([record], delay_s=0.0, resamples=1, beyond_plays=high_v == 150.0)
    calibration_of(found, made_for(seed)).save(path)
    return path


def made_for(seed: int) -> Made:
    return Made(utc="2026-01-01T00:00:00Z", edmctl="0.1.0", serial=f"SIM-{seed}", simulated=True)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with calibrations of SIM-1: whole, of a part of the stroke, not accepted, unreadable; and setups."""

    def make(folder: Path) -> None:
        whole = Calibration.load(calibrate(folder / "one.toml", 1))
        calibrate(folder / "narrow.toml", 1, 60.0)
        bad = whole.quality.model_copy(update={"accepted": False, "problems": ["A knock: measure again."]})
        whole.model_copy(update={"quality": bad}).save(folder / "doubtful.toml")
        t_s = np.linspace(0.0, 40.0, 2000)
        u_v = 105.0 - 45.0 * np.cos(2.0 * np.pi * 0.2 * t_s)
        y_um = 3.0 * u_v + 6.0 * np.sin(2.0 * np.pi * 0.2 * t_s - 1.6)
        upper = Record(t_s, u_v, y_um + np.random.default_rng(1).normal(0, 0.2, 2000))
        found = identify([upper], folds=2, resamples=1)
        calibration_of(found, made_for(1)).save(folder / "upper.toml")
        (folder / "broken.toml").write_text("schema = 1\n", encoding="utf-8")
        (folder / "no-sensor.toml").write_text(NO_SENSOR, encoding="utf-8")
        (folder / "no-swings.toml").write_text(
            f"{NO_SENSOR}[actuator]\nconditioning_cycles = 0\n", encoding="utf-8"
        )
        (folder / "named.toml").write_text('[actuator]\ncalibration = "none.toml"\n', encoding="utf-8")

    return once(tmp_path_factory, "calibrations", make)


@pytest.fixture
def first(files: Path) -> Path:
    """Return a calibration file of SIM-1."""
    return files / "one.toml"


@pytest.fixture
def no_sensor(files: Path) -> str:
    """Return a setup without a displacement sensor."""
    return str(files / "no-sensor.toml")


def machined(here: Here, *more: str) -> Said:
    return here("machine", *SHALLOW, "--seed", "1", "--json", *more)


def warned(said: Said) -> list[str]:
    return [warning["code"] for warning in said.document["warnings"]]


MODEL_ALONE = ("--setup", "no-sensor.toml", "--allow-model")


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--calibration", "none.toml"), "E3640", ""),
        (("--calibration", "broken.toml"), "E3642", ""),
        (("--setup", "named.toml"), "E3640", "none.toml"),
        (("--setup", "no-sensor.toml"), "E8030", "--allow-model"),
        (("--setup", "no-sensor.toml", "--dry-run"), "E8030", "--allow-model"),
        (("--setup", "no-swings.toml", "--allow-model"), "E8035", "conditioning_cycles = 2"),
        (MODEL_ALONE, "E8031", "`edmctl calibrate --seed 1`"),
        ((*MODEL_ALONE, "--calibration", "narrow.toml"), "E8032", "60.0 V"),
        ((*MODEL_ALONE, "--calibration", "narrow.toml"), "E8032", "120.0 V"),
        ((*MODEL_ALONE, "--calibration", "upper.toml"), "E8032", "covers 60.0 V to 150.0 V"),
        ((*MODEL_ALONE, "--calibration", "upper.toml", "--dry-run"), "E8032", "covers 60.0 V to 150.0 V"),
    ],
)
def test_a_calibration_that_cannot_serve_is_told_before_anything_moves(
    here: Here, files: Path, options: tuple[str, ...], code: str, words: str
) -> None:
    there = [
        str(files / word) if word.endswith(".toml") and word != "none.toml" else word for word in options
    ]
    said = machined(here, *there)
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (int(code[1]), code)
    assert words in f"{error['message']} {error['hint']}"
    assert not list(Path().glob("runs/*"))


@pytest.mark.parametrize(
    ("file", "seed", "code", "words"),
    [
        ("one.toml", "2", "W8101", "of SIM-1, not of SIM-2"),
        ("doubtful.toml", "1", "W8102", "A knock"),
        ("narrow.toml", "1", "W8104", "covers 0.0 V to 60.0 V; limits.stroke_v_max is 120.0 V"),
    ],
)
def test_a_calibration_that_may_not_fit_is_used_with_a_warning(
    here: Here, files: Path, monkeypatch: pytest.MonkeyPatch, file: str, seed: str, code: str, words: str
) -> None:
    monkeypatch.setenv("EDMCTL_CALIBRATION", str(files / file))  # goes before the setup
    said = machined(here, "--seed", seed, "--setup", str(files / "named.toml"))
    assert (said.exit_code, warned(said)) == (0, [code])
    used = said.document["result"]["calibration"]
    assert words in f"{said.document['warnings'][0]['message']} {used['text']}"
    assert (used["path"], used["accepted"]) == (str(files / file), file != "doubtful.toml")


def test_without_a_calibration_the_quick_model_is_named(here: Here) -> None:
    said = machined(here)
    assert said.document["result"]["calibration"] == {
        "alone": False,
        "path": None,
        "sha256": None,
        "accepted": None,
        "text": "quick, from the conditioning swings",
    }
    with h5py.File(said.document["run_file"]) as file:
        assert file["/entry/machine/calibration"].asstr()[()].startswith("quick, from")
        assert file["/entry/machine/calibration_toml"].asstr()[()] == ""


def test_the_machine_s_own_calibration_is_found_and_named_everywhere(
    here: Here, first: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("EDMCTL_HOME", str(tmp_path))
    own = kept_path("calibration", "SIM-1", {"EDMCTL_HOME": str(tmp_path)})
    own.parent.mkdir()
    own.write_bytes(first.read_bytes())
    kept = ("--port", "sim:bench.h5")
    said = machined(here, *kept)
    used = said.document["result"]["calibration"]
    assert used["path"] == str(own)
    assert used["sha256"] == Calibration.load(first).sha256[:12]
    assert used["accepted"] is True
    assert warned(said) == []
    with h5py.File(said.document["run_file"]) as file:
        assert file["/entry/machine/calibration"].asstr()[()] == used["text"]
        assert file["/entry/machine/calibration_toml"].asstr()[()] == first.read_text()
        summary = json.loads(bytes(file["/entry/summary"][()]))
        (row,) = file["/entry/results"][()]
    assert to_json_value(summary["calibration"]) == used
    (site,) = said.document["result"]["sites"]
    assert row["err_feed_max"] == pytest.approx(site["feed_model_error_max_um"], abs=1e-3)
    assert site["feed_model_error_max_um"] < 1.5
    table = here("machine", *SHALLOW, *kept).out
    assert f"Actuator model: calibration {own} (sha256 {used['sha256']}, accepted)." in table


def test_a_job_on_the_model_alone_says_what_that_costs(here: Here, first: Path, no_sensor: str) -> None:
    more = ("--setup", no_sensor, "--allow-model", "--calibration", str(first))
    said = machined(here, *more)
    assert said.exit_code == 0
    assert warned(said) == ["W8105"]
    message = said.document["warnings"][0]["message"]
    for cost in ("µm rms", "2.5 % of gain", "5 µm per newton"):
        assert cost in message
    (site,) = said.document["result"]["sites"]
    assert abs(site["depth_um"] - site["truth"]["depth_um"]) <= site["depth_u95_um"]
    assert site["feed_model_error_max_um"] is None
    assert said.document["result"]["calibration"]["alone"] is True


def test_simulate_names_the_model_of_every_run(here: Here, first: Path) -> None:
    said = here("simulate", *SHALLOW, "--runs", "1", "--seed", "1", "--json", "--calibration", str(first))
    (run,) = said.document["result"]["cases"][0]["runs"]
    assert run["calibration"].startswith(f"calibration {first} (sha256 ")


def ranged(low_v: float, high_v: float) -> Any:
    return SimpleNamespace(low_v=low_v, high_v=high_v)


@pytest.mark.parametrize(
    ("low_v", "used_v", "reaches"),
    [
        (0.0, (0.0, 120.0), True),
        (18.0, (0.0, 120.0), True),
        (18.1, (0.0, 120.0), False),
        (60.0, (60.0, 120.0), True),
        (60.0, (40.0, 120.0), False),
        (-150.0, (-150.0, 150.0), True),
    ],
)
def test_a_calibration_serves_a_little_below_its_lowest_voltage(
    low_v: float, used_v: tuple[float, float], reaches: bool
) -> None:
    assert reaches_down(ranged(low_v, 150.0), *used_v) is reaches
    tops = [reaches_up(ranged(0.0, 120.0), *limits) for limits in ((120.0,), (120.05,), (120.05, 0.1))]
    assert tops == [True, False, True]


def test_a_waveform_is_told_of_at_both_ends() -> None:
    t_s = np.arange(1000) / 50.0
    u_v = 60.0 - 60.0 * np.cos(t_s)
    plain = Record(t_s, u_v, 3.0 * u_v + np.random.default_rng(1).normal(0.0, 0.2, 1000))
    narrow = replace(identify([plain], delay_s=0.0, folds=2, resamples=0).model, low_v=60.0, high_v=90.0)
    (up, down) = run_trial([Waveform("ramp", np.linspace(0.0, 100.0, 500))], narrow, seed=3).doubts
    assert (up.code, up.message) == ("W8104", "ramp goes up to 100.0 V and the calibration to 90.0 V.")
    assert (down.code, down.message) == ("W8104", "ramp goes down to 0.0 V and the calibration to 60.0 V.")


T_S = np.arange(500) / 50.0
U_V = 75.0 - 75.0 * np.cos(T_S)


@pytest.mark.parametrize(("column", "value"), [("t_s", 1e300), ("u_V", -1.7e308), ("y_um", 9.9e37)])
def test_a_number_that_nothing_measures_is_named_with_its_sample(
    here: Here, column: str, value: float
) -> None:
    columns = {"t_s": T_S, "u_V": U_V, "y_um": 3.0 * U_V + np.sin(T_S)}
    write_columns(Path("good.csv"), columns)
    columns[column] = np.where(np.arange(500) == 41, value, columns[column])
    write_columns(Path("huge.csv"), columns)
    for files in (("--from", "huge.csv"), ("--from", "good.csv", "--validate", "huge.csv")):
        error = here("calibrate", *files, "--json").document["error"]
        told = f"huge.csv: 1 of 500 values of {column} cannot have been measured"
        assert (error["code"], error["message"]) == ("E3612", f"{told}, the first, {value:g}, at sample 42.")
        assert error["hint"]


def test_a_lever_file_and_values_that_are_not_finite_are_checked_alike(here: Here) -> None:
    write_columns(Path("huge.csv"), {"x_um": U_V, "z_um": 1e300 * U_V})
    error = here("calibrate", "--lever", "huge.csv", "--json").document["error"]
    assert error["code"] == "E3622"
    assert "of 500 values of z_um cannot have been measured" in error["message"]
    write_columns(Path("inf.csv"), {"t_s": T_S, "u_V": U_V, "y_um": np.where(U_V > 149.0, np.inf, U_V)})
    error = here("calibrate", "--from", "inf.csv", "--json").document["error"]
    assert "of y_um are not finite" in error["message"]
