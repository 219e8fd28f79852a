"""`edmctl calibrate`."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from edmctl.actuator.identification import identify
from edmctl.actuator.record import Record
from edmctl.actuator.validation import validate
from edmctl.actuator.waveforms import Waveform, jump_train, sampled, slow_legs, triangle
from edmctl.app import main
from edmctl.cli.signals import SignalArrived
from edmctl.errors import Interrupted
from edmctl.jobs import calibrate as calibration_run
from edmctl.jobs import corrections as calibrated
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.calibration import MeasuredActuator
from edmctl.profile.calibration import Calibration
from edmctl.profile.setup import Setup
from edmctl.record.columns import read_record, write_columns
from edmctl.simulator.plant import RATE_HZ, VirtualActuator
from tests.cli.commands import CU270, Here, Said

SEED = 3
PLAIN = partial(identify, folds=2, resamples=0, beyond_plays=False)
FIGURES = {"max_um", "rms_um", "max_pct", "rms_pct", "range_um"}


@dataclass(frozen=True, slots=True)
class Run:
    """What a whole run on the virtual machine left behind."""

    document: Mapping[str, Any]
    err: str
    home: Path

    @property
    def result(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.document["result"]
        return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One calibration of the virtual machine, into a home of its own; tests only look at it."""
    home = tmp_path_factory.mktemp("home")
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setenv("EDMCTL_HOME", str(home))
        patch.delenv("EDMCTL_CALIBRATION", raising=False)
        patch.delenv("EDMCTL_PORT", raising=False)
        assert main(["calibrate", "--seed", str(SEED), "--json"]) == 0
    return Run(json.loads(out.getvalue()), err.getvalue(), home)


@pytest.fixture
def home(here: Here) -> Path:
    """The folder of what edmctl keeps, empty."""
    return Path(os.environ["EDMCTL_HOME"])


def measured(waveform: Waveform, every: int = 20) -> Record:
    """What a sensor sees of the virtual actuator, by `every` so manyth sample of a millisecond."""
    driven = VirtualActuator(SEED).drive(waveform.u_v)
    return Record(driven.t_s[::every], driven.applied_v[::every], driven.sensor_um[::every])


@dataclass(frozen=True, slots=True)
class Files:
    """Measured data of one actuator: what to fit, and two records to validate on."""

    fit: Path
    jumps: Path
    swings: Path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Measured files, 50 samples a second."""
    folder = tmp_path_factory.mktemp("measured")
    found = Files(folder / "fit.csv", folder / "jumps.h5", folder / "swings.csv")
    for path, waveform in (
        (found.fit, sampled(slow_legs(150.0), RATE_HZ)),
        (found.jumps, jump_train(0.0, 120.0, RATE_HZ)),
        (found.swings, triangle(0.0, 150.0, 0.2, 4, RATE_HZ)),
    ):
        record = measured(waveform)
        write_columns(path, {"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um})
    return found


@pytest.fixture
def files(written: Files, monkeypatch: pytest.MonkeyPatch) -> Files:
    """The measured files, and fits that spare most of the work of being exact and of telling how sure they are."""
    monkeypatch.setattr("edmctl.jobs.calibrate.identify", PLAIN)
    return written


def fitted(here: Here, files: Files, *arguments: str) -> Said:
    """Fit the file, as one JSON object."""
    return here("calibrate", "--from", str(files.fit), *arguments, "--json")


# ------------------------------------------------------------------------------------------------ on a machine
def test_the_virtual_machine_is_known_within_1_percent_on_blocks_that_the_model_did_not_see(run: Run) -> None:
    result = run.result
    assert result["accepted"]
    assert result["held_out"]["max_pct"] <= 1.0
    assert result["held_out"]["rms_pct"] <= 0.3
    assert result["stroke_um"] == pytest.approx(450.0, abs=20.0)
    assert 0.01 < result["gamma_per_decade"] < 0.06
    line, maxwell = (result["baselines"][name]["rms_um"] for name in ("line", "maxwell"))
    assert line > 2.0 * maxwell > 10.0 * result["held_out"]["rms_um"]
    assert result["baselines_on"] == "held-out blocks"


def test_the_result_has_the_keys_that_scripts_depend_on_and_nothing_else_is_left(run: Run) -> None:
    result = run.result
    for figures in (result["train"], result["held_out"], *result["baselines"].values()):
        assert set(figures) == FIGURES
    assert (result["validate"], result["validate_files"], result["lever"]) == (None, [], None)
    assert (result["refit"], result["problems"]) == (["zero"], [])
    assert result["bands"]["gamma_sd_per_decade"] > 0.0
    assert (run.document["warnings"], run.document["simulated"], run.document["seed"]) == ([], True, SEED)
    assert "simulated run on the virtual machine, seed 3" in run.err
    assert "calibrating; 6 min" in run.err
    assert "\r" not in run.err
    assert Calibration.load(Path(result["calibration_file"])).made.simulated
    assert [path.name for path in run.home.rglob("*") if path.is_file()] == ["SIM-3.toml"]


def test_the_file_of_a_fresh_machine_is_used_where_it_is_named(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDMCTL_HOME", str(run.home))
    file = Path(run.result["calibration_file"])
    assert file == run.home / "calibration" / "fresh" / "SIM-3.toml"
    profile, serial = load_profile(CU270, ()).profile, f"SIM-{SEED}"
    for lasting in (False, True):
        unnamed = calibrated.choose(None, os.environ, Setup(), profile, serial, lasting=lasting)
        assert (unnamed.used.path, unnamed.actuator) == (None, None)
    choice = calibrated.choose(file, os.environ, Setup(), profile, serial, lasting=False)
    assert choice.used.path == str(file)
    assert (choice.used.accepted, choice.warnings) == (True, ())
    assert choice.actuator is not None
    assert choice.actuator.model.stroke_um == pytest.approx(run.result["stroke_um"], abs=1e-3)


def test_where_the_file_is_and_how_it_is_used_is_said(
    here: Here, quick: None, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, fresh = home / "calibration" / "SIM-3.toml", home / "calibration" / "fresh" / "SIM-3.toml"
    kept = ("calibrate", "--port", "sim:bench.h5")
    assert f"Saved in {own}: " in here(*kept, "--seed", "3").out
    own.write_text("an older one", encoding="utf-8")
    way = "`edmctl machine --profile PROFILE --port sim:bench.h5` uses it on SIM-3 from now on"
    assert here(*kept).out.splitlines()[-1].endswith(f"Replaced {own}: {way}.")
    assert Calibration.load(own).serial == "SIM-3"
    way = f"`edmctl machine --profile PROFILE --seed 3 --calibration {fresh}` uses it."
    for done in ("Saved in", "Replaced"):
        said = here("calibrate", "--seed", "3").out
        assert said.splitlines()[-1] == f"Simulated, seed 3. {done} {fresh}: {way}"
    monkeypatch.setenv("EDMCTL_CALIBRATION", "other.toml")
    assert "`edmctl machine` uses other.toml" in here(*kept, "--quiet").out


def test_a_machines_model_is_validated_on_files_too_and_lost_telemetry_is_doubtful(
    here: Here, files: Files, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = MeasuredActuator(read_record(files.fit), 2)
    monkeypatch.setattr(calibration_run, "measure_actuator", lambda *_: done)
    validated = ("--validate", str(files.jumps), "--previous-voltage", "150")
    document = here("calibrate", "--seed", "3", *validated, "--json").document
    assert document["result"]["validate"]["max_pct"] <= 1.0
    assert document["result"]["calibration_file"].endswith("SIM-3.toml")
    (warning,) = document["warnings"]
    assert (warning["code"], warning["message"][:8]) == ("W3611", "2 frames")


def test_a_calibration_in_use_is_not_replaced_by_one_that_is_not_accepted(
    here: Here, quick: None, files: Files, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = ("calibrate", "--port", "sim:bench.h5")
    here(*kept, "--seed", "3")
    own = home / "calibration" / "SIM-3.toml"
    before = own.read_bytes()
    shaky = read_record(files.fit)
    y_um = shaky.y_um + 8.0 * np.random.default_rng(1).standard_normal(len(shaky.y_um))
    worse = MeasuredActuator(shaky._replace(y_um=y_um), 0)
    monkeypatch.setattr(calibration_run, "measure_actuator", lambda *_: worse)
    said = here(*kept, "--json")
    assert said.exit_code == 0
    assert own.read_bytes() == before
    assert not Calibration.load(own.with_name("SIM-3-not-accepted.toml")).quality.accepted
    assert {"W3652", "W3660"} <= {warning["code"] for warning in said.document["warnings"]}
    assert said.document["result"]["calibration_file"].endswith("SIM-3-not-accepted.toml")


# ----------------------------------------------------------------------------- when it comes to no calibration
@pytest.fixture
def quick(files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare the five minutes: the machine measures what stands in a file."""
    done = MeasuredActuator(read_record(files.fit), 0)
    monkeypatch.setattr(calibration_run, "measure_actuator", lambda *_: done)


def test_what_was_measured_is_kept_when_no_model_can_be_fitted(
    here: Here, quick: None, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        fail_to_fit(patch, ValueError("no answer to the voltage"))
        said = here("calibrate", "--seed", "1", "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (3, "E3619")
        (warning,) = said.document["warnings"]
        assert warning["code"] == "W3660"
        (kept,) = [path for path in home.rglob("*") if path.is_file()]
        assert str(kept) in warning["message"]
        patch.setattr("edmctl.record.disk.write_new", no_space)
        (warning,) = here("calibrate", "--seed", "1", "--json").document["warnings"]
        assert warning["message"].startswith("What was measured is lost")
    assert here("calibrate", "--from", str(kept), "--dry-run").exit_code == 0
    kept.unlink()
    fail_to_fit(monkeypatch, SignalArrived(2))
    assert here("calibrate", "--seed", "1", "--json").exit_code == 130
    assert [path.suffix for path in home.rglob("*") if path.is_file()] == [".h5"]


def test_a_stop_while_measuring_leaves_nothing(
    here: Here, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from edmctl.machine.waits import Waits

    def stopped(*_: object) -> NoReturn:
        raise Interrupted("Stopped by SIGTERM.", signal_number=15)

    monkeypatch.setattr(Waits, "rest", stopped)
    said = here("calibrate", "--seed", "1", "--json")
    assert said.exit_code == 143
    assert (said.document["result"], said.document["warnings"]) == (None, [])
    assert not list(home.iterdir())


def fail_to_fit(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def failing(*_: object, **__: object) -> NoReturn:
        raise error

    monkeypatch.setattr("edmctl.jobs.calibrate.identify", failing)


def no_space(*_: object) -> NoReturn:
    raise OSError(28, "No space left on device")


# ------------------------------------------------------------------------------------------------ measured data
def test_several_validation_files_count_by_their_samples_and_worst_error(
    here: Here, files: Files, home: Path
) -> None:
    said = fitted(here, files, "--validate", str(files.jumps), "--validate", str(files.swings))
    result = said.document["result"]
    each, whole = result["validate_files"], result["validate"]
    assert [file["name"] for file in each] == ["jumps.h5", "swings.csv"]
    assert whole["max_um"] == max(file["max_um"] for file in each)
    assert whole["max_pct"] <= 1.0
    assert whole["rms_pct"] <= 0.3
    counts = [
        np.count_nonzero(read_record(path).t_s >= file["judged_from_s"] - 1e-6)
        for path, file in zip((files.jumps, files.swings), each, strict=True)
    ]
    rms_um = np.sqrt(np.average([file["rms_um"] ** 2 for file in each], weights=counts))
    assert whole["rms_um"] == pytest.approx(rms_um, abs=1e-3)
    assert result["baselines_on"] == "validation files"
    assert result["baselines"]["line"]["rms_um"] > result["baselines"]["maxwell"]["rms_um"] > whole["rms_um"]
    assert (result["calibration_file"], said.document["simulated"]) == (None, None)
    assert "nothing is saved: --output FILE" in said.err
    assert not list(home.iterdir())


def test_validation_is_that_of_the_python_interface_and_a_clean_file_has_one_figure(
    here: Here, files: Files
) -> None:
    found = PLAIN([read_record(files.fit)])
    judged = validate(found.model, read_record(files.swings), ("gain", "zero"))
    options = ("--validate", str(files.swings), "--refit", "zero,gain", "--delay", f"{found.model.delay_s}")
    result = fitted(here, files, *options).document["result"]
    assert (result["refit"], result["delay_s"]) == (["gain", "zero"], pytest.approx(found.model.delay_s))
    assert result["validate"]["max_um"] == pytest.approx(judged.errors.max_um, abs=1e-3)
    assert result["validate"]["rms_pct"] == pytest.approx(judged.errors.rms_pct, rel=1e-4)
    (file,) = result["validate_files"]
    assert file["gain"] == pytest.approx(judged.gain, rel=1e-5)
    assert file["zero_um"] == pytest.approx(judged.zero_um, abs=1e-3)
    assert (result["validate_screened"], file["screened"], file["note"]) == (None, None, "")


def test_a_start_that_rings_and_outliers_count_and_the_figure_without_them_is_told(
    here: Here, files: Files
) -> None:
    record = read_record(files.jumps)
    y_um = record.y_um + 80.0 * np.exp(-record.t_s / 0.3) * np.cos(9.0 * record.t_s)
    y_um[[1500, 2500]] += (30.0, -30.0)
    write_columns(Path("rung.csv"), {"t_s": record.t_s, "u_V": record.u_v, "y_um": y_um})
    said = fitted(here, files, "--validate", "rung.csv")
    result = said.document["result"]
    (file,) = result["validate_files"]
    assert result["validate"]["max_um"] == file["max_um"] > 60.0
    assert file["screened"] == result["validate_screened"]
    assert set(file["screened"]) == FIGURES
    assert file["screened"]["max_pct"] <= 1.0
    assert 0.5 < file["rung_s"] < 3.0
    assert file["outliers"] == 2
    assert "2 of its samples, which stand out singly" in file["note"]
    text = here("calibrate", "--from", str(files.fit), "--validate", "rung.csv").out
    assert f"Note: {file['note']}" in text
    assert "edmctl, screened" in text


def test_an_output_is_a_calibration_of_these_files(here: Here, files: Files) -> None:
    said = here("calibrate", "--from", str(files.fit), "--previous-voltage", "0", "--output", "a.toml")
    assert "Saved in a.toml: `edmctl machine --profile PROFILE --calibration a.toml` uses it." in said.out
    made = Calibration.load(Path("a.toml")).made
    assert (made.serial, made.simulated) == (None, False)
    (source,) = made.records
    assert (source.name, source.previous_v) == ("fit.csv", 0.0)
    assert source.samples == len(read_record(files.fit).t_s)


def test_wrong_memory_costs_accuracy_and_each_file_has_its_own(here: Here, files: Files) -> None:
    def rms_um(*previous: str) -> float:
        options = [word for volts in previous for word in ("--previous-voltage", volts)]
        said = fitted(here, files, "--validate", str(files.jumps), *options)
        return float(said.document["result"]["validate"]["rms_um"])

    assert rms_um("150", "0") > 4.0 * rms_um("150", "150")


def test_a_lever_factor_alone_moves_nothing_and_may_stand_beside_a_fit(
    here: Here, files: Files, lever: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = fitted(here, files, "--lever", lever, "--delay", "0.0125").document["result"]
    assert result["lever"]["factor"] == pytest.approx(18.0, abs=0.02)
    assert (result["accepted"] is not None, result["delay_s"]) == (True, 0.0125)
    monkeypatch.setattr(calibration_run, "connected", None)
    monkeypatch.setenv("EDMCTL_PORT", "sim:")
    alone = here("calibrate", "--lever", lever, "--json").document["result"]["lever"]
    assert alone["factor"] == pytest.approx(18.0, abs=alone["u95"])
    assert 0.0 < alone["u95"] < 0.01
    assert (alone["offset_um"], alone["samples"]) == (pytest.approx(3.0, abs=0.1), 500)
    assert here("calibrate", "--lever", lever).out.startswith("lever factor   17.998 ± 0.003")


def test_what_is_not_accepted_is_a_warning_and_no_failure(here: Here, files: Files) -> None:
    record = read_record(files.fit)
    y_um = record.y_um + 10.0 * np.sin(record.t_s)
    write_columns(Path("loose.csv"), {"t_s": record.t_s, "u_V": record.u_v, "y_um": y_um})
    said = here("calibrate", "--from", "loose.csv", "--json")
    assert said.exit_code == 0
    assert not said.document["result"]["accepted"]
    problems = said.document["result"]["problems"]
    warnings = [w for w in said.document["warnings"] if w["code"] == "W3650"]
    assert [w["message"] for w in warnings] == [f"Not accepted: {problem}" for problem in problems]
    assert warnings[0]["hint"]


def test_validation_beyond_the_fitted_range_is_doubtful(here: Here, files: Files) -> None:
    (warning,) = here(
        "calibrate", "--from", str(files.jumps), "--validate", str(files.swings), "--json"
    ).document["warnings"][-1:]
    assert warning["code"] == "W3651"
    assert "swings.csv goes from 0 V to 150 V" in warning["message"]


# ------------------------------------------------------------------------------------------------ lever factor
@pytest.fixture
def lever() -> str:
    """A file with the displacements of stacks and tool, in the present folder."""
    rng = np.random.default_rng(1)
    x_um = 12.0 * np.sin(np.linspace(0.0, 6.0, 500))
    write_columns(Path("lever.csv"), {"x_um": x_um, "z_um": 18.0 * x_um + 3.0 + rng.normal(0.0, 0.3, 500)})
    return "lever.csv"


# ----------------------------------------------------------------------------------------------------- dry run
def test_a_dry_run_tells_the_legs_and_touches_nothing(
    here: Here, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration_run, "connected", None)
    said = here("calibrate", "--dry-run")
    assert said.out.splitlines()[1].split() == ["0.0", "150.0", "2.000"]
    assert "legs between 0 V and 150.0 V in 6 min 31 s" in said.out
    assert "moves of 5 to 50 Hz about three voltages in 5 s" in said.out
    plan = here("calibrate", "--dry-run", "--json").document["result"]["plan"]
    assert plan["duration_s"] == pytest.approx(391.3, abs=0.1)
    assert plan["legs"][0] == {"u_v": 150.0, "duration_s": 2.0}
    assert not list(home.iterdir())


def test_a_dry_run_with_files_only_reads_them(
    here: Here, files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_to_fit(monkeypatch, AssertionError())
    result = fitted(here, files, "--dry-run", "--output", "a.toml").document["result"]
    assert result["plan"] is None
    assert (result["from"][0]["name"], result["from"][0]["high_v"]) == ("fit.csv", 150.0)
    assert not Path("a.toml").exists()


# ---------------------------------------------------------------------------------------------------- mistakes
MISTAKES = [
    (["--refit", "junk"], "E2020", "'junk' is neither 'zero' nor 'gain,zero'"),
    (["--refit", "gain"], "E2020", "'gain' is neither"),
    (["--previous-voltage", "1", "--previous-voltage", "2"], "E2021", "given 2 times, and no file"),
    (["--from", "a.csv", "--previous-voltage", "nan"], "E2021", "no finite number"),
    (
        ["--from", "a.csv", "--validate", "b.csv", *["--previous-voltage", "1"] * 3],
        "E2021",
        "given 3 times, and 2 files are named",
    ),
    (["--delay", "-1"], "E2022", "--delay -1 s does not lie between"),
    (["--delay", "nan"], "E2022", "--delay nan s"),
    (["--from", "none.csv"], "E3601", "none.csv: there is no such file"),
    (["--validate", "none.csv"], "E3601", "none.csv: there is no such file"),
    (["--lever", "none.csv"], "E3601", "none.csv: there is no such file"),
    (["--setup", "none.toml"], "E3010", "none.toml"),
    (["--port", ""], "E2006", "names no machine"),
    (["--seed", "-1"], "E2005", "Seed -1"),
    (["--output", "."], "E9011", ". exists already"),
    (["--output", "file/a.toml"], "E9012", "is no folder that can be written"),
    (["--from", "a.csv", "--output", "file"], "E9011", "file exists already"),
    (["--setup", "no-sensor.toml"], "E8034", ""),
    (["--lever", "millimetres.csv"], "E3603", "x_um"),
]


@pytest.mark.parametrize(("arguments", "code", "message"), MISTAKES)
def test_a_mistake_is_named_before_anything_moves(
    arguments: list[str], code: str, message: str, here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration_run, "connected", None)
    Path("file").write_text("precious", encoding="utf-8")
    Path("no-sensor.toml").write_text("[sensor]\nfitted = false\n", encoding="utf-8")
    Path("millimetres.csv").write_text("x_mm,z_um\n" + "1,2\n" * 20, encoding="utf-8")
    error = refusal(here, *arguments)
    assert (error["code"], error["exit_code"]) == (code, int(code[1]))
    assert message in f"{error['message']} {error['hint']}"
    assert error["hint"]
    assert Path("file").read_text(encoding="utf-8") == "precious"


def test_a_home_that_cannot_be_written_is_noticed_before_anything_moves(
    here: Here, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home.rmdir()
    home.write_text("no folder", encoding="utf-8")
    monkeypatch.setattr(calibration_run, "measure_actuator", None)
    assert refusal(here)["code"] == "E9012"


def refusal(here: Here, *arguments: str) -> Mapping[str, Any]:
    """The error of a command line that leaves no result, with its exit code."""
    seed = () if "--seed" in arguments else ("--seed", "1")
    said = here("calibrate", *arguments, *seed, "--json")
    assert said.exit_code != 0
    assert said.document["result"] is None
    error: dict[str, Any] = {**said.document["error"], "exit_code": said.exit_code}
    return error
