"""The Python API: the same jobs as those of the command line, without any of it."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import edmctl
from edmctl.errors import Diagnostic, Interrupted, PreconditionError, ProfileError
from edmctl.jobs.runs.summary import wanted
from edmctl.jobs.surroundings import Unobserved
from edmctl.labels import Verdict
from edmctl.machine.stop import StopRequest
from edmctl.results.progress import Phase, Progress
from edmctl.toml_text import toml_value
from edmctl.wording import facts
from tests.cli.commands import ROOT, Here, command, environment
from tests.needs import skip_without
from tests.tiers import tiers

SHALLOW = {
    **{"target.depth_um": 8, "log.pulses": "off", "approach.speed_um_s": 5},
    **{"measure.fast_um_s": 50, "measure.settle_s": 0.2, "measure.dwell_s": 0.1},
}
EXAMPLES = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs/python.md").read_text(encoding="utf-8"), re.S | re.M
)


def as_options(overrides: Mapping[str, object]) -> list[str]:
    return [word for key, value in overrides.items() for word in ("--set", f"{key}={toml_value(value)}")]


@pytest.mark.parametrize("example", tiers(*EXAMPLES[:2], slow=EXAMPLES[2:]))
def test_an_example_of_the_page_works(example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "import optuna" in example:
        skip_without(["optuna"])
    exec(compile(example, "docs/python.md", "exec"), {"__name__": "example"})


def test_importing_loads_nothing_heavy() -> None:
    look = "import sys, edmctl; print(' '.join(sorted(sys.modules)))"
    told = subprocess.run([sys.executable, "-c", look], check=True, capture_output=True, text=True, cwd=ROOT)
    loaded = told.stdout.split()
    assert [name for name in loaded if name.startswith("edmctl.")] == ["edmctl.version"]
    assert not {"numpy", "numba", "h5py", "pydantic", "typer", "rich", "scipy"} & set(loaded)


def test_a_result_is_that_of_the_command(here: Here) -> None:
    report = edmctl.connect("sim:", seed=4).machine("cu270", overrides=SHALLOW)
    said = here("machine", "-p", "cu270", "--seed", "4", "--json", "--quiet", *as_options(SHALLOW))
    assert json.dumps(report.to_dict(), sort_keys=True) == json.dumps(said.document["result"], sort_keys=True)


@pytest.mark.slow
def test_threads_give_the_bytes_of_commands(tmp_path: Path) -> None:
    """Results and all rows of run files are equal byte for byte."""
    jobs: dict[str, dict[str, object]] = {
        "cu270": {"target.depth_um": 8},
        "w252": {"target.depth_um": 8, "log.pulses": "full"},
    }
    here, apart = tmp_path / "threads", tmp_path / "processes"

    def in_a_thread(profile: str) -> object:
        machine = edmctl.connect("sim:", seed=4, home=here / "home")
        return machine.machine(profile, overrides=jobs[profile], out=here, run_id=profile).to_dict()

    def in_a_process(profile: str) -> object:
        words = ["machine", "-p", profile, "--seed", "4", "--json", "--quiet", "--out", "."]
        done = subprocess.run(
            command(*words, "--run-id", profile, *as_options(jobs[profile])),
            cwd=apart,
            env=environment(EDMCTL_HOME=str(apart / "home")),
            capture_output=True,
            encoding="utf-8",
            check=True,
        )
        return json.loads(done.stdout)["result"]

    apart.mkdir()
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(in_a_thread, jobs))
    for profile, result in zip(jobs, results, strict=True):
        assert json.dumps(result, sort_keys=True) == json.dumps(in_a_process(profile), sort_keys=True)
        assert rows_of(here / f"{profile}.h5") == rows_of(apart / f"{profile}.h5")


def rows_of(path: Path) -> dict[str, bytes]:
    """Read the rows of every table."""
    from edmctl.report.export import TABLES

    with edmctl.open_run(path) as run:
        return {
            name: repr(run.table(table.path).tolist()).encode()
            if table.is_compound
            else b"".join(column.tobytes() for column in run.columns(table.path).values())
            for name, table in TABLES.items()
        }


def test_a_grid_is_worked_off_in_its_order_and_files_are_named_after_values_and_seed(tmp_path: Path) -> None:
    sweep: dict[str, list[float]] = {"target.depth_um": [6, 9], "servo.reference": [0.75]}
    overrides = {**SHALLOW, "target.depth_um": 6}
    reports = edmctl.simulate("cu270", seeds=[1, 2], sweep=sweep, overrides=overrides, out=tmp_path)
    assert [round(report.sites[0].depth_um / 3.0) for report in reports] == [2, 2, 3, 3]
    name = "target.depth_um-{}-servo.reference-0.75-seed{}.h5"
    named = {name.format(depth_um, seed) for depth_um in (6, 9) for seed in (1, 2)}
    assert {path.name for path in tmp_path.glob("*.h5")} == named
    stop = StopRequest()
    stop.request(signal.SIGINT)
    assert edmctl.simulate("cu270", [1, 2], overrides=SHALLOW, stop=stop) == []


def test_a_wrong_profile_is_raised_before_anything_runs() -> None:
    with pytest.raises(ProfileError):
        edmctl.simulate("cu270", seeds=[1], sweep={"target.depth_um": [8, -1]})


def test_a_stop_ends_a_job_in_order_and_is_told_by_its_report() -> None:
    stop = StopRequest()

    class Watch(Unobserved):
        def progress(self, progress: Progress) -> None:
            stop.request(signal.SIGTERM)

    report = edmctl.connect("sim:", seed=1).machine("cu270", overrides=SHALLOW, observer=Watch(), stop=stop)
    assert isinstance(report.error, Interrupted)
    with pytest.raises(Interrupted):
        report.raise_for_error()


def test_results_show_themselves_in_a_notebook(tmp_path: Path) -> None:
    machine = edmctl.connect("sim:", seed=1, home=tmp_path)
    report = machine.machine("cu270", overrides=SHALLOW)
    assert re.fullmatch(r"<Report: depth \d+\.\d+ ± \d+\.\d+ µm>", repr(report))
    assert report.seed == 1
    assert "<td>cu270-cu</td>" in report._repr_html_()
    frame = report.to_frame()
    assert frame["depth_um"][0] == pytest.approx(report.sites[0].depth_um, abs=1e-3)
    assert "truth_wear_um" in frame
    found = machine.approach("cu270", contact=True, out=tmp_path, warn=lambda _: None)
    assert re.match(r"<ProcedureReport: approach, kind contact, .*displacement \d+\.\d+ µm>", repr(found))
    assert found.to_frame()["displacement_um"][0] == found.to_dict()["displacement_um"]
    assert "<tr><td>displacement</td>" in found._repr_html_()
    found.raise_for_error()
    jumps = machine.jump_flush("cu270", count=3, out=tmp_path, run_id="jumps")
    assert list(jumps.to_frame()["number"]) == [1, 2, 3]
    assert jumps._repr_html_().count("<tr>") == 4
    with edmctl.open_run(tmp_path / "jumps.h5") as run:
        assert repr(run) == f"<RunFile {tmp_path / 'jumps.h5'}: Cu 270 µm on Cu, 180 µm deep, done>"
    assert repr(run) == f"<RunFile {tmp_path / 'jumps.h5'}, closed>"
    # Two errors of one name are two values.
    names = [name for name, _ in facts({"max_um": 1.0, "max_pct": 2.0, "rms_um": 3.0})]
    assert names == ["max, µm", "max, %", "rms"]


@pytest.mark.slow
def test_a_calibration_has_errors_and_acceptance_and_is_used(tmp_path: Path) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text("[sensor]\nfitted = false\n")
    calibration = edmctl.connect("sim:", seed=3, home=tmp_path).calibrate()
    assert calibration.accepted
    assert not calibration.problems
    assert calibration.path == tmp_path / "calibration" / "fresh" / f"{calibration.serial}.toml"
    assert calibration.held_out.rms_um < calibration.baselines["line"].rms_um
    assert list(calibration.to_frame()["model"]) == ["edmctl", "line", "maxwell"]
    assert re.match(r"<CalibrationReport: accepted, \d\.\d\d µm rms", repr(calibration))
    blind = edmctl.connect("sim:", seed=3, setup=setup, home=tmp_path)
    with pytest.raises(PreconditionError, match="No displacement sensor"):
        blind.approach("cu270", out=tmp_path)
    warned: list[Diagnostic] = []
    used = calibration.path
    options = {"out": tmp_path, "allow_model": True, "calibration": used, "warn": warned.extend}
    wear = blind.measure_wear("cu270", reference=True, **options)  # type: ignore[arg-type]
    assert wear.reached
    assert wear.model is not None
    assert wear.model.path == str(used)
    assert "W8105" in [warning.code for warning in warned]


@pytest.mark.slow
def test_measured_files_are_fitted_without_a_machine(tmp_path: Path) -> None:
    from edmctl.actuator.waveforms import sampled, slow_legs
    from edmctl.simulator.plant import HIGH_V, RATE_HZ, VirtualActuator

    driven = VirtualActuator(5).drive(sampled(slow_legs(HIGH_V), RATE_HZ).u_v)
    rows = zip(driven.t_s[::20], driven.applied_v[::20], driven.sensor_um[::20], strict=True)
    data = tmp_path / "data.csv"
    data.write_text("t_s,u_V,y_um\n" + "".join(f"{t:.3f},{u:.4f},{y:.4f}\n" for t, u, y in rows))
    fitted = edmctl.calibrate_files([data], output=tmp_path / "own.toml", validate=[data])
    assert fitted.path == tmp_path / "own.toml"
    assert fitted.path.is_file()
    assert fitted.validated is not None
    assert fitted.validated.rms_um < 0.5
    assert fitted.to_dict()["serial"] is None


def test_a_name_that_is_not_there_is_told() -> None:
    with pytest.raises(AttributeError, match="no attribute 'machines'"):
        edmctl.machines  # noqa: B018
    assert "connect" in dir(edmctl)


def test_values_of_numpy_are_values() -> None:
    overrides = {"target.depth_um": np.float64(8.5), "jump.height_um": np.int64(50)}
    profile = edmctl.load_profile("cu270", overrides=overrides).profile
    assert profile.target == edmctl.load_profile("cu270", overrides=["target.depth_um=8.5"]).profile.target
    assert profile.jump.height_um == 50.0
    assert edmctl.connect(seed=np.int64(7)).seed == 7


def test_a_forecast_is_a_result() -> None:
    ahead = edmctl.forecast("cu270")
    assert repr(ahead) == "<Forecast: 17 min 15 s, depth 180.00 µm, tool wear 70.02 µm>"
    assert "<td>time</td><td>17 min 15 s</td>" in ahead._repr_html_()
    assert ahead.to_dict()["time_s"] == ahead.to_frame()["time_s"][0]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_observer_that_raises_leaves_a_safe_machine_and_all_that_was_heard(
    error: type[BaseException], tmp_path: Path
) -> None:
    class Raising(Unobserved):
        def progress(self, progress: Progress) -> None:
            if progress.phase is Phase.MACHINING:
                raise error

    machine = edmctl.connect("sim:", seed=1)
    with pytest.raises(error):
        machine.machine("cu270", overrides=SHALLOW, observer=Raising(), out=tmp_path, run_id="a")
    with edmctl.open_run(tmp_path / "a.h5") as run:
        assert run.column("/entry/servo", "v_cmd")[-1] == 0.0
        assert int(run.number("/entry/exit_code")) == (130 if error is KeyboardInterrupt else 1)


def test_a_sheet_is_told_as_gone_through_and_what_was_not_touched_is_marked() -> None:
    report = edmctl.connect(seed=2).machine("foil-through")
    (site,) = report.sites
    assert math.isnan(site.depth_um)
    assert site.verdict is Verdict.SHOWN
    assert site.beyond_exit_um > 0.0
    assert site.z2_um - site.z3_um - site.face_um == pytest.approx(50.0 + site.beyond_exit_um, abs=0.5)
    assert repr(report) == "<Report: depth through>"
    assert "<td>through</td>" in report._repr_html_()


def test_a_machine_that_keeps_its_work_keeps_its_ledger_and_its_runs_say_what_was_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    machine = edmctl.connect("sim:bench", seed=1, home=tmp_path)
    first, second = (machine.machine("cu270", overrides={**SHALLOW, "target.depth_um": 4}) for _ in range(2))
    assert first.run_file is not None
    assert first.run_file.parent == Path("runs")
    assert abs(first.sites[0].x_um - second.sites[0].x_um) > 100.0
    done = {
        "to find the surface": machine.approach("cu270", contact=True),
        "to jump 60 µm": machine.jump_flush("cu270", count=1),
        "as the reference of its wear": machine.measure_wear("cu270", reference=True, warn=lambda _: None),
    }
    for words, report in done.items():
        assert report.run_file is not None
        with edmctl.open_run(report.run_file) as file:
            assert words in wanted(file)
