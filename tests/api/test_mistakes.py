"""Mistakes in Python: told before anything moves, with code and remedy."""

from __future__ import annotations

import copy
import pickle
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

import edmctl
from edmctl.errors import (
    Diagnostic,
    EdmError,
    EdmWarning,
    Interrupted,
    ProfileError,
    RunFileError,
    UsageError,
)
from edmctl.jobs.run_header import name_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run file of some jumps."""
    out = tmp_path_factory.mktemp("runs")
    report = edmctl.connect(seed=1).jump_flush("cu270", count=1, out=out, run_id="jumps")
    assert report.run_file is not None
    return Path(report.run_file)


@pytest.mark.parametrize(
    ("read", "said", "hint"),
    [
        (lambda file: file.column("/entry/servo", "v_gap"), "v_gap", "v_gap_avg"),
        (lambda file: file.column("/entry/serv", "time"), "/entry/serv", "/entry/servo"),
        (lambda file: file.column("/entry/results", "depth"), "/entry/results", ""),
        (lambda file: file.table("/entry/servo"), "no table", "columns('/entry/servo')"),
        (lambda file: file.rows("/entry/nope"), "There is no table '/entry/nope'", ""),
    ],
)
def test_what_a_run_file_does_not_hold_is_named_with_what_it_holds(
    run: Path, read: Callable[[Any], object], said: str, hint: str
) -> None:
    with edmctl.open_run(run) as opened, pytest.raises(RunFileError, match=said) as caught:
        read(opened)
    assert caught.value.code == "E9015"
    assert hint in caught.value.hint
    closed: list[Callable[[Any], object]] = [
        lambda file: file.column("/entry/servo", "time"),
        lambda file: file.table("/entry/touches"),
        lambda file: file.refresh(),
    ]
    for read_closed in closed:
        with pytest.raises(RunFileError, match="has been closed"):
            read_closed(opened)


def called(**arguments: Any) -> Callable[[], object]:
    return lambda: edmctl.connect(seed=1).machine("cu270", **arguments)


def simulated(sweep: Any) -> Callable[[], object]:
    return lambda: edmctl.simulate("cu270", seeds=[1], sweep=sweep)


NO_PLACE, NO_PATH = "no place of the stages", "profile has to be a name or a path"


@pytest.mark.parametrize(
    ("wrong", "kind", "said"),
    [
        (called(stop=threading.Event()), TypeError, "stop has to be an edmctl.StopRequest, not Event"),
        (called(observer=print), TypeError, "observer has to have the methods progress and note"),
        (called(warn=3), TypeError, "warn has to be called with warnings"),
        (called(overrides=[{"target.depth_um": 8}]), TypeError, "a mapping or texts like 'key=value'"),
        (called(overrides={"target.depth_um": None}), TypeError, r"target\.depth_um: NoneType"),
        (called(allow_model="yes"), TypeError, "allow_model has to be True or False, not 'yes'"),
        (called(out=7), TypeError, "out has to be a path, not int"),
        (called(out="runs", run_id=7), TypeError, "a run id has to be text, not int"),
        (called(run_id="a"), UsageError, "names a run file, and without `out` there is none"),
        (called(calibration=7), TypeError, "a file has to be a path, not int"),
        (
            simulated({"servo.reference": 0.7}),
            TypeError,
            r"reference has to have several values, like \[0.7\]",
        ),
        (simulated({"servo.reference": "0.7"}), TypeError, "has to have several values"),
        (simulated("servo.reference=0.7:0.9:3"), TypeError, "sweep has to be a mapping"),
        (lambda: edmctl.connect(seed=1).measure_wear(site=(5, 0)), TypeError, "site has to be the name"),  # type: ignore[arg-type]
        *((lambda port=port: edmctl.connect(port), TypeError, "port has to be a name") for port in (5, None)),
        *((lambda seed=seed: edmctl.connect(seed=seed), TypeError, "integer") for seed in (1.5, "3")),
        *((lambda wrong=wrong: edmctl.forecast(wrong), TypeError, NO_PATH) for wrong in (None, 270)),
        *(
            (lambda site=site: edmctl.connect(seed=1).approach("cu270", site_um=site), UsageError, NO_PLACE)
            for site in [(1e10, 0.0), (float("nan"), 0.0), "700,-300", (1.0, 2.0, 3.0), 5.0]
        ),
        *(
            (lambda count=count: edmctl.connect(seed=1).jump_flush("cu270", count=count), kind, said)
            for counts, kind, said in (
                ((0, -3), UsageError, "at least one"),
                (("3", 2.5), TypeError, "integer"),
            )
            for count in counts
        ),
        (lambda: edmctl.StopRequest().request(99), ValueError, "99"),
    ],
)
def test_a_wrong_argument_is_told_by_its_name_before_anything_runs(
    wrong: Callable[[], object],
    kind: type[Exception],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kind, match=said):
        wrong()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["/", "//", ".", "\0", "a\0b", "n" * 300, "folder/" * 1000, "loop/x", "~nobody-here/x"]
)
def test_a_port_that_names_no_file_is_a_clear_error(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    with pytest.raises((UsageError, RunFileError)) as error:
        edmctl.connect(f"sim:{name}").approach("cu270", out=tmp_path)
    assert (error.value.code in {"E2007", "E9020", "E9024"}, bool(error.value.hint)) == (True, True)
    assert [path.name for path in tmp_path.iterdir()] == ["loop"]


def test_a_traceback_shows_code_and_remedy_of_every_problem() -> None:
    with pytest.raises(ProfileError) as caught:
        edmctl.load_profile("cu270", overrides=["target.depth=3", "pulse.dty=0.3"])
    shown = "".join(traceback.format_exception(caught.value))
    assert "depth_um" in shown
    assert "duty" in shown
    assert shown.count("E3003") == 2
    assert edmctl.errors.EdmError is EdmError  # type: ignore[attr-defined, unused-ignore]


def test_a_series_whose_files_are_there_is_refused_before_it_runs(tmp_path: Path) -> None:
    (tmp_path / "cu270-seed2.h5").touch()
    with pytest.raises(RunFileError, match=r"cu270-seed2\.h5"):
        edmctl.simulate("cu270", seeds=[1, 2], overrides={"target.depth_um": 8}, out=tmp_path)
    with pytest.raises(UsageError, match=r"cu270-seed1 .* twice"):
        edmctl.simulate("cu270", seeds=[1, 1], out=tmp_path)
    assert list(tmp_path.iterdir()) == [tmp_path / "cu270-seed2.h5"]


def test_one_file_is_fitted_like_a_list_of_one(tmp_path: Path) -> None:
    for files in (tmp_path / "a.csv", str(tmp_path / "a.csv"), [tmp_path / "a.csv"]):
        with pytest.raises(EdmError, match=r"a\.csv"):
            edmctl.calibrate_files(files)


def test_what_is_doubtful_is_a_warning_of_python_unless_somebody_is_told() -> None:
    machine, doubtful = edmctl.connect(seed=1), {"target.depth_um": 4, "work.material": "unobtainium"}
    with pytest.warns(EdmWarning, match=r"^W3134 .*unobtainium.*; help: ") as seen:
        machine.machine("cu270", overrides=doubtful)
    assert seen[0].filename == __file__
    told: list[Sequence[Diagnostic]] = []
    edmctl.simulate("cu270", seeds=[1], overrides=doubtful, warn=told.append)
    machine.machine("cu270", overrides={"target.depth_um": 4}, warn=told.append)
    assert [[one.code for one in found] for found in told] == [["W3134"]]
    with pytest.warns(EdmWarning, match=r"^W4102: --controller firmware has no effect .*/dev/none"):
        edmctl.connect("/dev/none", controller="firmware")


def test_errors_travel_between_processes_as_what_they_are() -> None:
    missed = edmctl.connect("sim:", seed=1).machine(
        "cu270", overrides={"target.depth_um": 8, "limits.max_time_s": 100}, warn=lambda _: None
    )
    with pytest.raises(ProfileError) as refused:
        edmctl.load_profile("cu270", overrides={"pulse.duty": 0.99})
    stopped = Interrupted("Stopped.", signal_number=2)
    for error in (missed.error, refused.value, stopped, UsageError("No.", code="E2001")):
        assert error is not None
        for again in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error)):
            assert type(again) is type(error)
            assert str(again) == str(error)
            assert vars(again).keys() == vars(error).keys()
            assert (again.code, again.hint, again.exit_code) == (error.code, error.hint, error.exit_code)
    assert repr(pickle.loads(pickle.dumps(missed)).sites) == repr(missed.sites)  # NaN equals nothing


def test_jobs_that_begin_in_the_same_millisecond_have_names_of_their_own(tmp_path: Path) -> None:
    start = datetime(2026, 1, 31, 10, 15, tzinfo=UTC)
    with ThreadPoolExecutor(6) as pool:
        names = list(pool.map(lambda _: name_run(tmp_path, None, None, start, "touch").run_id, range(30)))
    assert len(set(names)) == 30
    assert "touch-20260131T101500.000Z" in names
