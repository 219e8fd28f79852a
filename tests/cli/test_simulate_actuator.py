"""`edmctl simulate actuator`: voltage through a virtual actuator and the models of it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.actuator.identification import Identification, identify
from edmctl.actuator.record import Record
from edmctl.actuator.waveforms import sampled, slow_legs
from edmctl.errors import RecordError, UsageError, installing
from edmctl.jobs.actuator_trial import Trial, Wanted, command_from, run_trial, waveforms, write_data
from edmctl.procedures.calibration import REST_S, plan_calibration
from edmctl.profile.calibration import Made, calibration_of
from edmctl.profile.setup import Setup
from edmctl.simulator.plant import RATE_HZ, VirtualActuator
from tests.cli.commands import Here

SHORT = ("simulate", "actuator", "sine", "--cycles", "1", "--quiet", "--seed", "3")


@pytest.fixture(scope="module")
def five() -> Trial:
    """The five waveforms on one actuator."""
    return run_trial(waveforms(Wanted("all", None, None, None, None, None)), None, seed=3)


def identified(high_v: float) -> Identification:
    """From the slow legs of a calibration, which are soon fitted."""
    driven = VirtualActuator(3).drive(sampled(slow_legs(high_v), RATE_HZ).u_v)
    record = Record(driven.t_s[::10], driven.applied_v[::10], driven.sensor_um[::10])
    return identify([record], folds=2, resamples=0)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A calibration file of the same actuator."""
    made = Made(utc="2026-01-31T10:15:00+00:00", edmctl="1", serial=VirtualActuator(3).serial, simulated=True)
    path = tmp_path_factory.mktemp("calibration") / "sim3.toml"
    calibration_of(identified(150.0), made).save(path)
    return str(path)


def test_the_model_is_identified_from_the_record_that_calibrates_a_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It ends with what a job does, and its fast legs are sampled as a machine samples them."""
    records: list[Record] = []

    def look(given: list[Record], **_: object) -> Identification:
        records.extend(given)
        raise LookupError

    monkeypatch.setattr("edmctl.jobs.actuator_trial.identify", look)
    with pytest.raises(LookupError):
        run_trial([], None, seed=3)
    (record,) = records
    plan = plan_calibration(Setup())
    assert record.t_s[-1] + REST_S == pytest.approx(plan.duration_s, rel=0.01)
    assert len(record.t_s) == pytest.approx(plan.samples, rel=0.01)
    assert np.percentile(np.diff(record.t_s), 5) == pytest.approx(1e-6 * plan.fast_period_us)


def test_the_papers_practice_is_several_times_worse_and_in_the_papers_own_range(five: Trial) -> None:
    worst = {key: max(w.models[key].max_um for w in five.waveforms) for key in ("line", "paper", "ours")}
    assert 5.0 * worst["ours"] < worst["paper"] < worst["line"]
    assert 15.0 < worst["paper"] < 40.0
    assert [w.name for w in five.waveforms] == ["sine 0.01 Hz", "sine 1 Hz", "step", "jumps", "servo"]
    for waveform in five.waveforms:
        paper, ours = waveform.models["paper"], waveform.models["ours"]
        assert paper.rms_um > 2.5 * ours.rms_um
        assert (ours.max_pct <= 1.0, ours.rms_pct <= 0.3) == (True, True)


def test_figures_are_errors_against_the_truth_with_one_zero_a_waveform(five: Trial, tmp_path: Path) -> None:
    for waveform, trace in zip(five.waveforms, five.traces, strict=True):
        assert waveform.truth["range_um"] == pytest.approx(np.ptp(trace.truth_um))
        for key, errors in waveform.models.items():
            off_um = trace.models_um[key] - trace.truth_um
            assert abs(off_um.mean()) < 1e-9
            assert errors.max_um == pytest.approx(np.abs(off_um).max())
            assert errors.rms_pct == pytest.approx(100.0 * off_um.std() / five.stroke_um)
    assert five.stroke_um == pytest.approx(445.0, abs=20.0)
    (jumps,) = waveforms(Wanted("jumps", None, None, None, None, None))
    driven = VirtualActuator(3).drive(jumps.command_v)
    assert np.array_equal(five.traces[3].truth_um, driven.truth_um)
    assert np.array_equal(five.traces[3].sensor_um, driven.sensor_um)
    write_data(five.traces, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r") as file:
        number, t_s = file["waveform"][:], file["t_s"][:]
    assert np.unique(number).tolist() == [1, 2, 3, 4, 5]  # waveforms are numbered, and each starts at 0 s
    assert np.array_equal(t_s[np.flatnonzero(np.diff(number)) + 1], np.zeros(4))


def test_the_result_is_a_table_for_people_and_keys_with_units_for_scripts(
    here: Here, calibration: str
) -> None:
    said = here(*SHORT, "--calibration", calibration)
    assert (said.exit_code, said.err) == (0, "")
    assert [line.split()[0] for line in said.out.splitlines()[:2]] == ["waveform", "sine"]
    assert "Simulated, seed 3." in said.out
    document = here(*SHORT, "--calibration", calibration, "--json").document
    assert document["command"] == "simulate actuator"
    assert (document["simulated"], document["seed"], document["ok"]) == (True, 3, True)
    (waveform,) = document["result"]["waveforms"]
    assert set(waveform) == {"name", "truth", "models"}
    assert list(waveform["models"]) == ["line", "paper", "ours"]
    assert set(waveform["models"]["ours"]) == {"max_um", "rms_um", "max_pct", "rms_pct"}
    assert 0.0 < waveform["models"]["ours"]["max_pct"] <= 1.0
    assert 300.0 < waveform["truth"]["range_um"] < document["result"]["stroke_um"]
    assert (document["result"]["plot_file"], document["result"]["data_file"]) == (None, None)


def test_figure_and_data_are_written_and_the_same_for_the_same_seed(here: Here, calibration: str) -> None:
    known = (*SHORT, "--calibration", calibration)
    for name in ("a", "b"):
        said = here(*known, "--plot", f"{name}.svg", "--data", f"{name}.csv", "--json")
        assert said.exit_code == 0
        assert (said.document["result"]["plot_file"], said.document["result"]["data_file"]) == (
            f"{name}.svg",
            f"{name}.csv",
        )
    assert Path("a.svg").read_bytes() == Path("b.svg").read_bytes()
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    header = Path("a.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "t_s,u_V,truth_um,sensor_um,paper_um,ours_um,line_um"
    columns = np.loadtxt("a.csv", delimiter=",", skiprows=1)
    assert columns.shape == (1001, 7)
    errors = said.document["result"]["waveforms"][0]["models"]["ours"]
    assert np.abs(columns[:, 5] - columns[:, 2]).max() == pytest.approx(errors["max_um"], abs=6e-4)


def test_a_voltage_from_a_file_is_applied_as_straight_lines_as_steep_as_the_machine_can(
    here: Here, calibration: str
) -> None:
    Path("u.csv").write_text("t_s,note,u_V\n10,a,0\n10.5,b,100\n11,c,100\n", encoding="utf-8")
    u_v = command_from(Path("u.csv"), 60.0)
    assert u_v.size == RATE_HZ + 1
    assert u_v[[0, 250, 500, 1000]] == pytest.approx([0.0, 50.0, 100.0, 100.0])
    Path("u.csv").write_text("t_s,u_V\n0,0\n0.001,100\n2,100\n", encoding="utf-8")
    known = ("--seed", "3", "--calibration", calibration, "--json")
    said = here("simulate", "actuator", "csv", "--from", "u.csv", *known)
    (waveform,) = said.document["result"]["waveforms"]
    assert (said.exit_code, waveform["name"]) == (0, "u.csv")
    assert waveform["models"]["ours"]["max_pct"] <= 1.0
    (warning,) = said.document["warnings"]
    assert warning["code"] == "W8103"
    assert "up to 99.0 V away" in warning["message"]


def test_options_of_a_job_and_of_the_subcommand_are_kept_apart(here: Here) -> None:
    said = here("simulate", "--runs", "3", "actuator", "sine")
    assert said.exit_code == 2
    assert "--runs stands before 'actuator'; options go after it." in said.err
    assert here("simulate", "--profile", "cu270", "--dry-run", "--json").document["command"] == "simulate"
    assert "\n  actuator " in here("simulate", "--help").out
    assert here("simulate", "actuator", "--help").out.startswith("Usage: edmctl simulate actuator ")
    assert here("simulate", "nonsense", "--json").document["command"] == "simulate nonsense"


def test_a_calibration_is_judged_and_another_actuators_is_doubted(here: Here, calibration: str) -> None:
    own = here(*SHORT, "--calibration", calibration, "--json").document
    assert own["warnings"] == []
    assert own["result"]["waveforms"][0]["models"]["ours"]["max_pct"] <= 1.0
    other = here(*SHORT[:-1], "4", "--calibration", calibration, "--json")
    assert other.exit_code == 0
    (warning,) = other.document["warnings"]
    assert warning["code"] == "W8101"
    assert "is of SIM-3; this actuator is that of SIM-4" in warning["message"]
    worse = other.document["result"]["waveforms"][0]["models"]["ours"]["max_pct"]
    assert worse > own["result"]["waveforms"][0]["models"]["ours"]["max_pct"]


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("t_s,u\n0,0\n1,1\n", "E3603", "no column u_V"),
        ("t_s,u_V\nnan,0\n1,1\n", "E3612", "row 1 (nan s, 0 V) is not finite"),
        ("t_s,u_V\n1,0\n1,1\n", "E3613", "row 2 (1 s, 1 V) is not later than the one before"),
        ("t_s,u_V\n0,0\n1,151\n", "E3630", "row 2 (1 s, 151 V) is outside 0 to 150 V"),
        ("t_s,u_V\n0,-1\n1,1\n", "E3630", "row 1 (0 s, -1 V) is outside"),
        ("t_s,u_V\n0,0\n4000,1\n", "E3631", "lasts 4000 s; 1800 s is the longest"),
    ],
)
def test_a_bad_file_is_named_with_what_is_wrong_in_it(
    text: str, code: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("u.csv").write_text(text, encoding="utf-8")
    with pytest.raises(RecordError) as refused:
        waveforms(Wanted("csv", None, None, None, None, Path("u.csv")))
    assert refused.value.code == code
    assert refused.value.message.startswith("u.csv")
    assert message in refused.value.message
    assert "y_um" not in refused.value.message
    assert refused.value.hint


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("sinus", "E2000", "'sinus' is not one of"),
        ("", "E2000", "Missing argument"),
        ("csv", "E2010", "No CSV file was named"),
        ("csv --from none.csv", "E3601", "none.csv: there is no such file."),
        ("csv --from u.csv --high 90", "E2010", "--high does not go with csv"),
        ("sine --from u.csv", "E2010", "--from does not go with sine"),
        ("servo --frequency 2", "E2010", "--frequency does not go with servo"),
        ("fig4 --frequency 2", "E2010", "--frequency does not go with fig4"),
        ("all --cycles 2", "E2010", "--cycles does not go with all"),
        ("sine --cycles 0", "E2000", "0 is not in the range"),
        ("sine --high 151", "E2010", "--high 151 do not ascend within the actuator's 0 to 150 V"),
        ("sine --low -5", "E2010", "--low -5 and"),
        ("sine --low 50 --high 50", "E2010", "do not ascend"),
        ("sine --frequency 0", "E2010", "do not end within 1800 s"),
        ("sine --frequency 0.001", "E2010", "5 cycles of 0.001 Hz do not end within 1800 s"),
        ("sine --frequency 5", "E2010", "steeper than the machine's 1000 V/s"),
        ("square --frequency 5", "E2010", "steeper than the machine's 1000 V/s"),
        ("sine --plot a.jpg", "E2011", "'a.jpg': its name ends in none of .png, .svg, .pdf"),
        ("sine --plot there.png", "E9011", "there.png"),
        ("sine --data a.txt", "E2012", "'a.txt': its name ends in none of .csv, .h5"),
        ("sine --data there.csv", "E9011", "there.csv"),
        ("sine --data none/a.csv", "E9012", "there is no folder none"),
        ("sine --seed -1", "E2005", "Seed -1"),
        ("sine --calibration none.toml", "E3640", "none.toml"),
        ("sine --start virgin", "E2010", "--start goes with --model paper"),
        ("sine --model paper --calibration a.toml", "E2010", "--calibration does not go"),
    ],
)
def test_a_mistake_is_named(words: str, code: str, message: str, here: Here) -> None:
    for name in ("there.png", "there.csv"):
        Path(name).write_bytes(b"precious")
    seed = () if "--seed" in words else ("--seed", "3")
    said = here("simulate", "actuator", *words.split(), *seed, "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (int(code[1]), code)
    assert said.document["command"] in ("simulate actuator", "simulate")
    assert message in error["message"]
    assert error["hint"].endswith((".", "?"))
    assert {Path(name).read_bytes() for name in ("there.png", "there.csv")} == {b"precious"}


def test_a_figure_without_matplotlib_names_the_remedy(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    error = here(*SHORT, "--plot", "a.png", "--json").document["error"]
    assert (error["code"], error["hint"]) == ("E8090", f"Install it: {installing('matplotlib')}.")


def test_frequencies_and_ranges_as_asked_for() -> None:
    (slow,) = waveforms(Wanted("sine", 0.01, 10.0, 90.0, 2, None))
    assert slow.command_v.size == 200 * RATE_HZ + 1
    assert (slow.command_v.min(), slow.command_v.max()) == pytest.approx((10.0, 90.0))
    (square,) = waveforms(Wanted("square", 2.0, None, None, 3, None))
    assert square.command_v.size == pytest.approx(1.5 * RATE_HZ, abs=2)
    with pytest.raises(UsageError, match="1800 s"):
        waveforms(Wanted("triangle", 1.0, None, None, 1801, None))
