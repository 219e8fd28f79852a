"""Mistakes in Python: told before anything moves, with code and remedy."""

from __future__ import annotations

import copy
import pickle
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import edmctl
from edmctl.errors import EdmError, EdmWarning, Interrupted, ProfileError, RunFileError, UsageError
from edmctl.jobs.run_header import name_run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from edmctl.errors import Diagnostic
    from edmctl.record.reader import RunFile


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run file of some jumps."""
    out = tmp_path_factory.mktemp("runs")
    report = edmctl.connect(seed=1).jump_flush("cu270", count=1, out=out, run_id="jumps")
    assert report.run_file is not None
    return Path(report.run_file)


@pytest.mark.parametrize(
    ("path", "name", "meant"),
    [
        ("/entry/servo", "v_gap", "v_gap_avg"),
        ("/entry/serv", "time", "/entry/servo"),
        ("/entry/results", "depth", ""),
    ],
)
def test_a_column_that_is_not_there_is_named_with_those_that_are(
    run: Path, path: str, name: str, meant: str
) -> None:
    with edmctl.open_run(run) as opened, pytest.raises(RunFileError) as caught:
        opened.column(path, name)
    assert caught.value.code == "E9015"
    assert meant in caught.value.hint


def test_a_group_is_no_table(run: Path) -> None:
    with edmctl.open_run(run) as opened, pytest.raises(RunFileError, match="no table"):
        opened.table("/entry/servo")


@pytest.mark.parametrize(
    "read",
    [lambda opened: opened.column("/entry/servo", "time"), lambda opened: opened.table("/entry/touches")],
)
def test_a_closed_file_says_so(run: Path, read: Any) -> None:
    opened: RunFile = edmctl.open_run(run)
    opened.close()
    with pytest.raises(RunFileError, match="has been closed"):
        read(opened)


@pytest.mark.parametrize("site_um", [(1e10, 0.0), (float("nan"), 0.0), "700,-300", (1.0, 2.0, 3.0), 5.0])
def test_a_place_where_no_stage_can_be_is_refused(site_um: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no place of the stages"):
        edmctl.connect(seed=1).approach("cu270", site_um=site_um, out=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("count", "kind"), [(0, UsageError), (-3, UsageError), ("3", TypeError), (2.5, TypeError)]
)
def test_jumps_are_counted_before_the_machine_runs(count: Any, kind: type[Exception], tmp_path: Path) -> None:
    with pytest.raises(kind):
        edmctl.connect(seed=1).jump_flush("cu270", count=count, out=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_profile_is_a_name_or_a_path() -> None:
    loaded = edmctl.load_profile("cu270")
    for wrong in (loaded, None, 270):
        with pytest.raises(TypeError, match="profile has to be a name or a path"):
            edmctl.forecast(wrong)  # type: ignore[arg-type, unused-ignore]


@pytest.mark.parametrize("port", [5, None, b"sim:"])
def test_a_port_is_a_name_or_a_path(port: Any) -> None:
    with pytest.raises(TypeError, match="port has to be a name or a path, not"):
        edmctl.connect(port)


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


def test_errors_are_there_without_another_import() -> None:
    assert edmctl.errors.EdmError is EdmError  # type: ignore[attr-defined, unused-ignore]


def called(**arguments: Any) -> Callable[[], object]:
    return lambda: edmctl.connect(seed=1).machine("cu270", **arguments)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (called(stop=threading.Event()), "stop has to be an edmctl.StopRequest, not Event"),
        (called(observer=print), "observer has to have the methods progress and note"),
        (called(warn=3), "warn has to be called with warnings"),
        (called(overrides=[{"target.depth_um": 8}]), "a mapping or texts like 'key=value'"),
        (called(allow_model="yes"), "allow_model has to be True or False, not 'yes'"),
        (called(out=7), "out has to be a path, not int"),
        (called(out="runs", run_id=7), "a run id has to be text, not int"),
        (called(calibration=7), "a file has to be a path, not int"),
        (
            lambda: edmctl.simulate("cu270", seeds=[1], sweep={"servo.reference": 0.7}),  # type: ignore[dict-item]
            r"sweep: servo.reference has to have several values, like \[0.7\]",
        ),
        (
            lambda: edmctl.simulate("cu270", seeds=[1], sweep={"servo.reference": "0.7"}),
            "has to have several values",
        ),
        (
            lambda: edmctl.simulate("cu270", seeds=[1], sweep="servo.reference=0.7:0.9:3"),  # type: ignore[arg-type]
            "sweep has to be a mapping",
        ),
        (lambda: edmctl.connect(seed=1).measure_wear(site=(500, 0)), "site has to be the name"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_argument_at_all_is_told_by_its_name(wrong: Callable[[], object], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        wrong()


def test_a_run_without_a_file_has_no_name() -> None:
    with pytest.raises(UsageError, match="names a run file, and without `out` there is none"):
        edmctl.connect(seed=1).machine("cu270", run_id="a")


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


DOUBTFUL = {"target.depth_um": 8, "work.material": "unobtainium"}


def test_what_is_doubtful_is_a_warning_of_python_unless_somebody_is_told() -> None:
    machine = edmctl.connect(seed=1)
    with pytest.warns(EdmWarning, match=r"^W3134 .*unobtainium.*; help: ") as seen:
        machine.machine("cu270", overrides=DOUBTFUL)
    assert seen[0].filename == __file__
    with pytest.warns(EdmWarning, match="W3134"):
        edmctl.simulate("cu270", seeds=[1], overrides=DOUBTFUL)
    told: list[Sequence[Diagnostic]] = []
    edmctl.simulate("cu270", seeds=[1], overrides=DOUBTFUL, warn=told.append)
    machine.machine("cu270", overrides={"target.depth_um": 8}, warn=told.append)
    assert [[one.code for one in found] for found in told] == [["W3134"]]


def test_a_controller_for_a_port_is_doubtful() -> None:
    with pytest.warns(EdmWarning, match=r"^W4102: --controller firmware has no effect .*/dev/none"):
        edmctl.connect("/dev/none", controller="firmware")


def test_errors_travel_between_processes_as_what_they_are(tmp_path: Path) -> None:
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


def test_a_number_that_is_no_signals_stops_nothing() -> None:
    with pytest.raises(ValueError, match="99"):
        edmctl.StopRequest().request(99)


def test_a_table_that_no_layout_has_is_told(run: Path) -> None:
    file = edmctl.open_run(run)
    with file, pytest.raises(RunFileError, match="There is no table '/entry/nope'"):
        file.rows("/entry/nope")
    with edmctl.open_run(run) as again, pytest.raises(RunFileError) as refused:
        again.table("/entry/servo")
    assert "columns('/entry/servo')" in refused.value.hint
    with pytest.raises(RunFileError, match="has been closed"):
        file.refresh()
