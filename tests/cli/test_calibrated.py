"""Which calibration `machine` and `simulate` go by, what they say of it, and a machine without a sensor."""

from __future__ import annotations

import json
import os
import re
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
from edmctl.jobs.actuator_trial import run_trial
from edmctl.jobs.actuator_waveforms import Waveform
from edmctl.jobs.corrections import reaches_down, reaches_up
from edmctl.jsonout import to_json_value
from edmctl.profile.calibration import Made, calibration_of, load_calibration, save_calibration
from edmctl.profile.folders import default_path
from edmctl.record.columns import write_columns
from edmctl.simulator.actuator import VirtualActuator
from tests.cli.commands import SHALLOW, Here, Said

CALIBRATE = r"`edmctl (calibrate --seed \d+)`"


def calibrate(path: Path, seed: int, high_v: float = 150.0) -> Path:
    """Write the calibration of a virtual machine, from the slow legs at 50 Hz; a part of the stroke plainly."""
    waveform = sampled(slow_legs(high_v), 1000.0)
    driven = VirtualActuator(seed).drive(waveform.u_v)
    thin = slice(None, None, 20)
    record = Record(waveform.t_s[thin], driven.applied_v[thin], driven.sensor_um[thin])
    found = identify([record], delay_s=0.0, resamples=1, beyond_plays=high_v == 150.0)
    made = Made(utc="2026-01-01T00:00:00Z", edmctl="0.1.0", serial=f"SIM-{seed}", simulated=True)
    save_calibration(path, calibration_of(found, made))
    return path


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibration file of SIM-1."""
    return calibrate(tmp_path_factory.mktemp("calibrations") / "one.toml", 1)


@pytest.fixture
def no_sensor(tmp_path: Path) -> str:
    """Return a setup without a displacement sensor."""
    path = tmp_path / "no-sensor.toml"
    path.write_text("[sensor]\nfitted = false\n")
    return str(path)


def machined(here: Here, *more: str) -> Said:
    return here("machine", *SHALLOW, "--seed", "1", "--json", *more)


def warned(said: Said) -> list[str]:
    return [warning["code"] for warning in said.document["warnings"]]


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
    own = default_path("SIM-1", {"EDMCTL_HOME": str(tmp_path)})
    own.parent.mkdir()
    own.write_bytes(first.read_bytes())
    kept = ("--port", "sim:bench.h5")
    said = machined(here, *kept)
    used = said.document["result"]["calibration"]
    assert used["path"] == str(own)
    assert used["sha256"] == load_calibration(first).sha256[:12]
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


def test_an_option_goes_before_the_environment_and_that_before_the_setup(
    here: Here, first: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text('[actuator]\ncalibration = "none.toml"\n')
    assert machined(here, "--setup", str(setup)).document["error"]["code"] == "E3640"
    monkeypatch.setenv("EDMCTL_CALIBRATION", str(first))
    said = machined(here, "--setup", str(setup))
    assert said.document["result"]["calibration"]["path"] == str(first)
    assert machined(here, "--calibration", "none.toml").document["error"]["code"] == "E3640"


def test_a_calibration_that_cannot_be_read_is_told_before_anything_moves(here: Here, tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("schema = 1\n")
    said = machined(here, "--calibration", str(broken))
    assert said.exit_code == 3
    assert said.document["error"]["code"] == "E3642"
    assert not Path("runs").exists()


def test_another_machine_s_calibration_is_used_with_a_warning(here: Here, first: Path) -> None:
    said = here("machine", *SHALLOW, "--seed", "2", "--json", "--calibration", str(first))
    assert said.exit_code == 0
    assert warned(said) == ["W8101"]
    assert "of SIM-1, not of SIM-2" in said.document["result"]["calibration"]["text"]


def test_a_calibration_that_was_not_accepted_is_used_with_a_warning(
    here: Here, first: Path, tmp_path: Path
) -> None:
    calibration = load_calibration(first)
    bad = calibration.quality.model_copy(update={"accepted": False, "problems": ["A knock: measure again."]})
    doubtful = tmp_path / "doubtful.toml"
    save_calibration(doubtful, calibration.model_copy(update={"quality": bad}))
    said = machined(here, "--calibration", str(doubtful))
    assert warned(said) == ["W8102"]
    assert "A knock" in said.document["warnings"][0]["message"]
    assert said.document["result"]["calibration"]["accepted"] is False


def test_a_calibration_of_a_part_of_the_stroke_is_used_with_a_warning(here: Here, tmp_path: Path) -> None:
    narrow = calibrate(tmp_path / "narrow.toml", 1, 60.0)
    said = machined(here, "--calibration", str(narrow))
    assert said.exit_code == 0
    assert warned(said) == ["W8104"]
    assert "covers 0.0 V to 60.0 V; limits.stroke_v_max is 120.0 V" in said.document["warnings"][0]["message"]


def test_no_sensor_is_refused_until_the_model_is_allowed(here: Here, no_sensor: str) -> None:
    for more in ((), ("--dry-run",)):
        said = machined(here, "--setup", no_sensor, *more)
        assert (said.exit_code, said.document["error"]["code"]) == (8, "E8030")
        assert "--allow-model" in said.document["error"]["hint"]


def test_a_calibration_that_does_not_reach_down_to_rest_is_told_of(
    here: Here, tmp_path: Path, no_sensor: str
) -> None:
    t_s = np.linspace(0.0, 40.0, 2000)
    u_v = 105.0 - 45.0 * np.cos(2.0 * np.pi * 0.2 * t_s)
    rng = np.random.default_rng(1)
    upper = Record(
        t_s, u_v, 3.0 * u_v + 6.0 * np.sin(2.0 * np.pi * 0.2 * t_s - 1.6) + rng.normal(0, 0.2, 2000)
    )
    made = Made(utc="2026-01-01T00:00:00Z", edmctl="0.1.0", serial="SIM-1", simulated=True)
    path = tmp_path / "upper.toml"
    save_calibration(path, calibration_of(identify([upper], folds=2, resamples=1), made))
    assert "W8104" in warned(machined(here, "--calibration", str(path)))
    for more in ((), ("--dry-run",)):
        said = machined(here, "--setup", no_sensor, "--allow-model", "--calibration", str(path), *more)
        assert (said.exit_code, said.document["error"]["code"]) == (8, "E8032")
        assert "covers 60.0 V to 150.0 V" in said.document["error"]["message"]


def test_no_sensor_and_no_swings_before_the_job_is_refused(here: Here, no_sensor: str) -> None:
    with Path(no_sensor).open("a") as setup:
        setup.write("[actuator]\nconditioning_cycles = 0\n")
    said = machined(here, "--setup", no_sensor, "--allow-model")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8035")
    assert "conditioning_cycles = 2" in said.document["error"]["hint"]


def test_no_sensor_and_no_calibration_is_refused(here: Here, no_sensor: str) -> None:
    said = machined(here, "--setup", no_sensor, "--allow-model")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8031")
    assert re.search(CALIBRATE, said.document["error"]["hint"]) is not None
    assert list(Path().glob("runs/*")) == []


@pytest.mark.slow
def test_what_is_asked_for_without_a_sensor_is_enough(here: Here, no_sensor: str) -> None:
    said = machined(here, "--setup", no_sensor, "--allow-model")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8031")
    command = re.search(CALIBRATE, said.document["error"]["hint"])
    assert command is not None
    assert here(*command[1].split()).exit_code == 0
    assert machined(here, "--setup", no_sensor, "--allow-model").exit_code == 8
    (file,) = Path(os.environ["EDMCTL_HOME"]).rglob("SIM-1.toml")
    named = machined(here, "--setup", no_sensor, "--allow-model", "--calibration", str(file))
    assert named.exit_code == 0


def test_no_sensor_and_too_small_a_calibration_is_refused_with_both_numbers(
    here: Here, no_sensor: str, tmp_path: Path
) -> None:
    narrow = calibrate(tmp_path / "narrow.toml", 1, 60.0)
    said = machined(here, "--setup", no_sensor, "--allow-model", "--calibration", str(narrow))
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8032")
    assert "60.0 V" in said.document["error"]["message"]
    assert "120.0 V" in said.document["error"]["message"]


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


def test_a_calibration_serves_up_to_its_highest_voltage() -> None:
    assert reaches_up(ranged(0.0, 120.0), 120.0)
    assert not reaches_up(ranged(0.0, 120.0), 120.05)
    assert reaches_up(ranged(0.0, 120.0), 120.05, tolerance_v=0.1)


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


@pytest.mark.parametrize("column", ["t_s", "u_V", "y_um"])
@pytest.mark.parametrize("value", [1e300, -1.7e308, 9.9e37])
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


def test_a_number_that_nothing_measures_gives_no_lever_factor(here: Here) -> None:
    write_columns(Path("huge.csv"), {"x_um": U_V, "z_um": 1e300 * U_V})
    said = here("calibrate", "--lever", "huge.csv", "--json")
    assert said.document["error"]["code"] == "E3622"
    assert "of 500 values of z_um cannot have been measured" in said.document["error"]["message"]


def test_what_is_not_finite_is_still_said_to_be_so(here: Here) -> None:
    write_columns(Path("inf.csv"), {"t_s": T_S, "u_V": U_V, "y_um": np.where(U_V > 149.0, np.inf, U_V)})
    assert (
        "of y_um are not finite"
        in here("calibrate", "--from", "inf.csv", "--json").document["error"]["message"]
    )
