"""Mistakes in Python: told before anything moves, with code and remedy."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import edmctl
from edmctl.errors import EdmError, ProfileError, RunFileError, UsageError

if TYPE_CHECKING:
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


def test_a_traceback_shows_code_and_remedy_of_every_problem() -> None:
    with pytest.raises(ProfileError) as caught:
        edmctl.load_profile("cu270", overrides=["target.depth=3", "pulse.dty=0.3"])
    shown = "".join(traceback.format_exception(caught.value))
    assert "depth_um" in shown
    assert "duty" in shown
    assert shown.count("E3003") == 2


def test_errors_are_there_without_another_import() -> None:
    assert edmctl.errors.EdmError is EdmError  # type: ignore[attr-defined, unused-ignore]
