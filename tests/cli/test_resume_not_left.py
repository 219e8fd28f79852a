"""`edmctl machine --resume` where work, place, tool or clock are not those that were left."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from edmctl.record.bench_file import read_bench
from edmctl.record.journal import read_journal, write_journal
from edmctl.simulator.saving import restored_bench
from tests.cli.left_jobs import (
    BENCH,
    MACHINE,
    RESUME,
    TARGET_UM,
    TOLERANCE_UM,
    bench_changed,
    done,
    error_of,
    killed_at,
    lengthen_tool,
    move_work,
    refused,
    stop,
    swap_work,
    taken_over,
    worn_um,
)
from tests.golden import once
from tests.serving import serving
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.procedures.run import UnderWay
    from edmctl.record.journal import Journal
    from edmctl.simulator import VirtualBench
    from tests.cli.commands import Here

    LeaveAt = Callable[[float], Journal]

DEEP = ("--set", 'target={kind="depth",depth_um=60.0,tolerance_um=2.0}')
DEEP_UM = 60.0
ARRAY = (
    *("--set", 'array={surface="pad",order="given"}'),
    *(
        "--set",
        'sites=[{name="one",x_um=700,y_um=0},{name="two",x_um=1500,y_um=0},{name="three",x_um=2300,y_um=0}]',
    ),
)


@pytest.fixture
def left_at(here: Here, tmp_path_factory: pytest.TempPathFactory) -> LeaveAt:
    """Return what leaves a job that was killed so long after its first cut began in the folder of the test."""
    order = (*MACHINE, *DEEP, "--seed", "3")
    killed = killed_at(tmp_path_factory, "deep-hole", order, (0.5, 3.0, 12.0, 30.0, 55.0))
    return lambda seconds: taken_over(killed[seconds])


@pytest.mark.parametrize("seconds", tiers(slow=(12.0, 30.0), full=(55.0,)))
def test_untouched_work_is_refused_and_made_from_its_face_when_asked(
    here: Here, left_at: LeaveAt, seconds: float
) -> None:
    left_at(seconds)
    expected_um = float(read_journal(Path("runs/a.journal")).state["depth_um"])  # type: ignore[arg-type]
    bench_changed(swap_work)
    told = refused(here, "E8060")
    assert f"the journal expects {expected_um:.2f}" in told
    assert "--restart-hole" in told
    assert "--homed" not in told
    before_um = worn_um()
    (site,) = done(here(*RESUME, "--restart-hole", *BENCH))["sites"]
    assert site["truth"]["wear_um"] == pytest.approx(worn_um() - before_um, abs=1e-3)
    assert abs(site["truth"]["depth_um"] - DEEP_UM) <= 2.5
    assert abs(site["depth_um"] - site["truth"]["depth_um"]) <= max(1.0, site["depth_u95_um"])
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 1.5


def test_a_board_that_was_moved_is_refused(here: Here, left_at: LeaveAt) -> None:
    left_at(30.0)
    bench_changed(move_work)
    assert "Put the workpiece back as it was" in refused(here, "E8060")


@pytest.mark.slow
def test_a_hole_that_was_begun_is_not_restarted(here: Here, left_at: LeaveAt) -> None:
    left_at(30.0)
    (hole,) = restored_bench(read_bench(Path("bench.h5"))).truth()
    assert "no untouched face" in refused(here, "E8062", "--restart-hole")
    assert restored_bench(read_bench(Path("bench.h5"))).truth() == (hole,)
    (site,) = done(here(*RESUME, *BENCH))["sites"]
    assert site["truth"]["wear_um"] == pytest.approx(worn_um(), abs=1e-3)


@pytest.mark.parametrize("way_um", tiers(-20.0, 8.0, slow=(25.0,)))
def test_a_tool_that_was_seated_anew_is_refused(here: Here, left_at: LeaveAt, way_um: float) -> None:
    left_at(30.0)
    bench_changed(lengthen_tool(way_um))
    assert "seated anew" in refused(here, "E8061")


def test_a_tool_that_is_gone_says_what_was_expected(here: Here, left_at: LeaveAt) -> None:
    left_at(12.0)
    bench_changed(lengthen_tool(-120.0))
    said = here(*RESUME, *BENCH)
    assert (said.exit_code, error_of(said)["code"]) == (6, "E62005")
    assert "may not be those that were left" in str(error_of(said)["hint"])
    assert list(Path("runs").glob("*.journal"))


@pytest.mark.parametrize("seconds", tiers(3.0, slow=(0.5,), full=(12.0, 30.0, 55.0)))
def test_the_work_that_was_left_is_taken_up(here: Here, left_at: LeaveAt, seconds: float) -> None:
    left_at(seconds)
    (site,) = done(here(*RESUME, *BENCH))["sites"]
    assert abs(site["truth"]["depth_um"] - DEEP_UM) <= 2.5


@pytest.fixture
def leave_between(here: Here, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Leave an array that was stopped when its first hole was finished and the second one not begun."""
    from edmctl.procedures.run import JobStateKeeper

    keep = JobStateKeeper.keep

    def kept(
        keeper: JobStateKeeper, phase: str, under_way: UnderWay | None, time_s: float | None = None
    ) -> None:
        keep(keeper, phase, under_way, time_s)
        if under_way is None:
            stop()

    def make(golden: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(golden)
            patch.setattr(JobStateKeeper, "keep", kept)
            assert here(*MACHINE, *ARRAY, *BENCH, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130

    state = taken_over(once(tmp_path_factory, "between-two-holes", make)).state
    assert (len(state["done"]), state["begun"]) == (1, False)  # type: ignore[arg-type]


@pytest.mark.usefixtures("leave_between")
@pytest.mark.parametrize("change", tiers(swap_work, slow=(move_work,)))
def test_between_two_holes_the_last_one_tells_whose_work_it_is(
    here: Here, change: Callable[[VirtualBench], None]
) -> None:
    bench_changed(change)
    assert "one at (700, 0) µm is" in refused(here, "E8060")
    assert "no hole that could be made anew" in refused(here, "E8062", "--restart-hole")


@pytest.mark.slow
@pytest.mark.usefixtures("leave_between")
def test_between_two_holes_a_job_goes_on(here: Here) -> None:
    sites = done(here(*RESUME, *BENCH))["sites"]
    assert [site["name"] for site in sites] == ["one", "two", "three"]
    assert all(abs(site["truth"]["depth_um"] - TARGET_UM) <= TOLERANCE_UM + 1.0 for site in sites)


@pytest.mark.slow
def test_a_clock_that_was_set_back_widens_the_wear_and_spares_the_depth(here: Here, left_at: LeaveAt) -> None:
    left_at(30.0)
    in_time = served_result(here, 0.0)
    late = served_result(here, 86_400.0)
    assert in_time["pause_s"] < 60.0
    assert in_time["sites"][0]["wear_u95_um"] < 3.0
    assert late["pause_s"] is None
    assert late["sites"][0]["wear_u95_um"] > 200.0
    assert late["sites"][0]["depth_u95_um"] < 1.5
    assert abs(late["sites"][0]["depth_um"] - DEEP_UM) <= 2.5


def served_result(here: Here, ahead_s: float) -> dict[str, Any]:
    """The result on a served machine, where a pause counts, with a journal from `ahead_s` in the future."""
    home = Path.cwd()
    there = home.with_name(f"{home.name}-{ahead_s:.0f}")
    shutil.copytree(home, there)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        journal = read_journal(Path("runs/a.journal"))
        write_journal(Path("runs/a.journal"), replace(journal, written_utc_s=time.time() + ahead_s))
        with serving(restored_bench(read_bench(Path("bench.h5")))) as port:
            said = here(*RESUME, "--port", port, "--homed")
    assert said.exit_code == 0, said.out
    result: dict[str, Any] = said.document["result"]
    return result
