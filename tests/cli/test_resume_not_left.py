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
    at_time_of_cut,
    bench_changed,
    error_of,
    lengthen_tool,
    move_work,
    snapshot_and_stop,
    stop,
    swap_work,
)
from tests.serving import serving

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.procedures.job_state import UnderWay
    from edmctl.simulator import VirtualBench
    from tests.cli.commands import Here

DEEP = ("--set", 'target={kind="depth",depth_um=60.0,tolerance_um=2.0}')
DEEP_UM = 60.0
ARRAY = (
    *("--set", 'array={surface="pad",order="given"}'),
    *(
        "--set",
        'sites=[{name="one",x_um=700,y_um=0},{name="two",x_um=1500,y_um=0},{name="three",x_um=2300,y_um=0}]',
    ),
)


def left_at(here: Here, seconds: float, *more: str) -> None:
    """Leave a job that was killed so long after its first cut began; what reached the disk lies in the folder."""
    home, snapshot = Path.cwd(), Path.cwd().with_name(f"{Path.cwd().name}-killed")
    with at_time_of_cut(seconds, snapshot_and_stop(home, snapshot)):
        assert here(*MACHINE, *more, *BENCH, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130
    for entry in home.iterdir():
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    shutil.copytree(snapshot, home, dirs_exist_ok=True)
    shutil.rmtree(snapshot)


def refused(here: Here, code: str, *more: str) -> str:
    """Go on, and return the words of a refusal that has sparked nothing and leaves a journal of the same hole."""
    (before,) = Path("runs").glob("*.journal")
    state, worn_um = read_journal(before).state, worn_so_far_um()
    said = here(*RESUME, *more, *BENCH)
    error = error_of(said)
    assert (error["code"], said.exit_code) == (code, 8), error
    assert worn_so_far_um() == worn_um
    # What the journal estimates of a hole that is not there is no result of this run.
    if (result := said.document["result"]) is not None:
        assert state["site"] not in [site["name"] for site in result["sites"]]
        assert result["reached"] is None
    (after,) = Path("runs").glob("*.journal")
    for name in ("site", "begun", "depth_um", "depth_u_um", "wear_um", "wear_u_um", "feed_u_um", "counts"):
        assert read_journal(after).state[name] == state[name], name
    return f"{error['message']} {error['hint']}"


def worn_so_far_um() -> float:
    return restored_bench(read_bench(Path("bench.h5"))).tool_wear_um


@pytest.mark.parametrize("seconds", [12.0, 30.0, 55.0])
def test_untouched_work_is_refused_and_made_from_its_face_when_asked(here: Here, seconds: float) -> None:
    left_at(here, seconds, *DEEP)
    expected_um = float(read_journal(Path("runs/a.journal")).state["depth_um"])  # type: ignore[arg-type]
    bench_changed(swap_work)
    told = refused(here, "E8060")
    assert f"the journal expects {expected_um:.2f}" in told
    assert "--restart-hole" in told
    assert "--homed" not in told
    before_um = worn_so_far_um()
    said = here(*RESUME, "--restart-hole", *BENCH)
    assert said.exit_code == 0, said.out
    truth = said.document["result"]["sites"][0]["truth"]
    assert truth["wear_um"] == pytest.approx(worn_so_far_um() - before_um, abs=1e-3)
    (site,) = said.document["result"]["sites"]
    assert abs(site["truth"]["depth_um"] - DEEP_UM) <= 2.5
    assert abs(site["depth_um"] - site["truth"]["depth_um"]) <= max(1.0, site["depth_u95_um"])
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 1.5


def test_a_board_that_was_moved_is_refused(here: Here) -> None:
    left_at(here, 30.0, *DEEP)
    bench_changed(move_work)
    assert "Other work, or other places" in refused(here, "E8060")


def test_a_hole_that_was_begun_is_not_restarted(here: Here) -> None:
    left_at(here, 30.0, *DEEP)
    (hole,) = restored_bench(read_bench(Path("bench.h5"))).truth()
    assert "no untouched face" in refused(here, "E8062", "--restart-hole")
    assert restored_bench(read_bench(Path("bench.h5"))).truth() == (hole,)
    said = here(*RESUME, *BENCH)
    assert said.exit_code == 0
    (site,) = said.document["result"]["sites"]
    assert site["truth"]["wear_um"] == pytest.approx(worn_so_far_um(), abs=1e-3)


@pytest.mark.parametrize("way_um", [-20.0, 8.0, 25.0])
def test_a_tool_that_was_seated_anew_is_refused(here: Here, way_um: float) -> None:
    left_at(here, 30.0, *DEEP)
    bench_changed(lengthen_tool(way_um))
    assert "seated anew" in refused(here, "E8061")


def test_a_tool_that_is_gone_says_what_was_expected(here: Here) -> None:
    left_at(here, 12.0, *DEEP)
    bench_changed(lengthen_tool(-120.0))
    said = here(*RESUME, *BENCH)
    assert (said.exit_code, error_of(said)["code"]) == (6, "E62005")
    assert "may not be those that were left" in str(error_of(said)["hint"])
    assert list(Path("runs").glob("*.journal"))


@pytest.mark.parametrize("seconds", [0.5, 3.0, 12.0, 30.0, 55.0])
def test_the_work_that_was_left_is_taken_up(here: Here, seconds: float) -> None:
    left_at(here, seconds, *DEEP)
    said = here(*RESUME, *BENCH)
    assert said.exit_code == 0, said.out
    (site,) = said.document["result"]["sites"]
    assert abs(site["truth"]["depth_um"] - DEEP_UM) <= 2.5


@pytest.mark.parametrize("change", [swap_work, move_work])
def test_between_two_holes_the_last_one_tells_whose_work_it_is(
    here: Here, change: Callable[[VirtualBench], None]
) -> None:
    leave_between(here)
    bench_changed(change)
    assert "one at (700, 0) µm is" in refused(here, "E8060")
    assert "no hole that could be made anew" in refused(here, "E8062", "--restart-hole")


def test_between_two_holes_a_job_goes_on(here: Here) -> None:
    leave_between(here)
    said = here(*RESUME, *BENCH)
    assert said.exit_code == 0, said.out
    sites = said.document["result"]["sites"]
    assert [site["name"] for site in sites] == ["one", "two", "three"]
    assert all(abs(site["truth"]["depth_um"] - TARGET_UM) <= TOLERANCE_UM + 1.0 for site in sites)


def leave_between(here: Here) -> None:
    """Stop an array when its first hole is finished and the second one not begun."""
    from edmctl.procedures.state_keeper import JobStateKeeper

    keep = JobStateKeeper.keep

    def kept(
        keeper: JobStateKeeper, phase: str, under_way: UnderWay | None, time_s: float | None = None
    ) -> None:
        keep(keeper, phase, under_way, time_s)
        if under_way is None:
            stop()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JobStateKeeper, "keep", kept)
        assert here(*MACHINE, *ARRAY, *BENCH, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130
    state = read_journal(Path("runs/a.journal")).state
    assert (len(state["done"]), state["begun"]) == (1, False)  # type: ignore[arg-type]


def test_a_clock_that_was_set_back_widens_the_wear_and_spares_the_depth(here: Here) -> None:
    left_at(here, 30.0, *DEEP)
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
