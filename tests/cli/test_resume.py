"""`edmctl machine --resume`: a job that was interrupted in the middle of a cut, and all the reasons not to go on."""

from __future__ import annotations

import errno
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import pytest

from edmctl.errors import LinkLost, MachineFault
from edmctl.jobs.connected_machine import CALENDAR, Now
from edmctl.jobs.job import add_way_on
from edmctl.jobs.resume import checked, find_run, resumed_job
from edmctl.jobs.run_header import RunName
from edmctl.link.faults import FaultCode
from edmctl.machine.controller import LinkMachine
from edmctl.machine.interface import Touch, TouchRequest
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import REPORT_DELAY_S, job_of
from edmctl.profile.setup import Setup
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.record.journal import read_journal, write_journal
from edmctl.record.ledger import (
    UNFINISHED,
    Entry,
    JobBegun,
    Ledger,
    RunEnded,
    SiteMachined,
    ToolChanged,
    WearMeasured,
    history_of,
)
from edmctl.record.reader import open_run
from edmctl.record.rows import RunEvent
from edmctl.simulator import VirtualBench
from edmctl.simulator.saving import bench_state, restored_bench
from tests.cli.commands import CU270, ROOT, Here, Said
from tests.cli.left_jobs import (
    BENCH,
    MACHINE,
    QUICK,
    RESUME,
    TARGET_UM,
    TOLERANCE_UM,
    at_event,
    at_time_of_cut,
    bench_changed,
    done,
    error_of,
    killed_at,
    snapshot_and_stop,
    stop,
)
from tests.serving import serving
from tests.tiers import tiers

ARRAY = str(ROOT / "profiles" / "array-3x3.toml")
INTO_THE_CUT_S = 8.0


@dataclass(frozen=True, slots=True)
class Left:
    """Folders as an interrupted job leaves them: stopped by Ctrl-C, and killed at the same instant."""

    stopped: Path
    killed: Path


@pytest.fixture(scope="session")
def left(tmp_path_factory: pytest.TempPathFactory) -> Left:
    """One job on a kept bench, interrupted in its first cut."""
    order = (*MACHINE, "--seed", "3")
    (killed,) = killed_at(tmp_path_factory, "hole", order, (INTO_THE_CUT_S,)).values()
    return Left(killed.with_name("home"), killed)


@pytest.fixture
def killed(left: Left, here: Here) -> Path:
    """The killed job's folder, for `here` to work in."""
    shutil.copytree(left.killed, Path.cwd(), dirs_exist_ok=True)
    return Path.cwd()


def refused(said: Said, code: str) -> str:
    """The message of a refusal that has changed nothing: the journal is still there."""
    error = error_of(said)
    assert error["code"] == code, error
    assert said.exit_code == int(code[1])
    assert Path("runs/a.journal").exists()
    return str(error["message"])


@contextmanager
def dying_at(*places: str, error: Exception | None = None) -> Iterator[None]:
    """Raise an error in functions of the job, else a lost line."""

    def dies(*_: object, **__: object) -> None:
        raise error or LinkLost("made for this test")

    with pytest.MonkeyPatch.context() as patch:
        for place in places:
            patch.setattr(place, dies)
        yield


def assert_on_target(said: Said) -> None:
    (site,) = done(said)["sites"]
    assert abs(site["depth_um"] - TARGET_UM) <= TOLERANCE_UM
    assert abs(site["depth_um"] - site["truth"]["depth_um"]) <= 1.0
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 1.5


def latch(bench: VirtualBench) -> None:
    bench.controller.raise_fault(FaultCode.HOST_SILENT)


def fit_other_tool(bench: VirtualBench) -> None:
    bench.fit_tool("W 252 µm", 252.0, bench.plant.config.tool_wear, 0.0)


def exchange_machine() -> None:
    bench = restored_bench(read_bench(Path("bench.h5")))
    bench.plant.serial = "SIM-99"
    Path("bench.h5").unlink()
    write_bench(Path("bench.h5"), bench_state(bench))


def ledger_goes_on(*entries: Entry) -> None:
    ledger = Ledger.open(Path("runs"))
    ledger.append(ledger.lines[0].serial, *entries)


def change_journal(**changes: str) -> None:
    journal = read_journal(Path("runs/a.journal"))
    write_journal(Path("runs/a.journal"), replace(journal, job=replace(journal.job, **changes)))  # type: ignore[arg-type]


def strip_journal() -> None:
    journal = read_journal(Path("runs/a.journal"))
    state = {name: value for name, value in journal.state.items() if name != "counts"}
    write_journal(Path("runs/a.journal"), replace(journal, state=state))


OTHER_JOB = JobBegun("Cu 270 µm", "b.h5", 150.0, (("x", 3000.0, 0.0),))


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (partial(bench_changed, latch), "E8010", "reset --ack 1001"),
        (exchange_machine, "E8055", "This is SIM-99"),
        (Path("bench.h5").unlink, "E8058", ""),
        (partial(ledger_goes_on, ToolChanged("Cu 270 µm")), "E8056", "changed for a new one"),
        (
            partial(ledger_goes_on, WearMeasured("W 252 µm", "b.h5", 50.0, 1.0, 0.5)),
            "E8056",
            "W 252 µm was in the machine",
        ),
        (partial(ledger_goes_on, OTHER_JOB), "E8056", "has machined b.h5"),
        (partial(bench_changed, fit_other_tool), "E8056", "W 252 µm is in the machine"),
        (partial(change_journal, profile_sha256="0"), "E8053", ""),
        (partial(change_journal, sim_sha256="0"), "E8053", ""),
        (partial(change_journal, setup_sha256="0"), "E8053", ""),
        (partial(change_journal, profile="/gone.toml"), "E8053", ""),
        (strip_journal, "E8052", "does not fit this version"),
    ],
)
def test_a_run_whose_machine_tool_or_recipe_has_changed_is_refused(
    here: Here, killed: Path, change: Callable[[], None], code: str, words: str
) -> None:
    change()
    said = here(*RESUME, *BENCH)
    assert words in f"{refused(said, code)} {error_of(said)['hint']}"
    if isinstance(change, partial) and change.func is ledger_goes_on:
        refused(here(*RESUME, *BENCH, "--dry-run"), code)
    elif code == "E8058":
        assert "No machine was named" in refused(here(*RESUME), code)
        assert not Path("bench.h5").exists()


def test_a_job_that_was_refused_before_it_sparked_has_used_no_tool(here: Here, killed: Path) -> None:
    ledger_goes_on(OTHER_JOB, RunEnded("b.h5", "precondition", 12.0))
    assert here(*RESUME, *BENCH, "--dry-run").exit_code == 0


@pytest.mark.parametrize("code", ["E8010", "E8100"])
def test_another_job_that_is_refused_leaves_nothing_to_take_up(here: Here, killed: Path, code: str) -> None:
    if code == "E8010":
        bench_changed(latch)
    there = ("--set", 'sites=[{name="there",x_um=1500,y_um=0}]', "--set", "flush.min_flow_lpm=2.0")
    error = error_of(here(*MACHINE, *BENCH, *there, "--new-tool", "--run-id", "b", "--json", "--quiet"))
    assert error["code"] == code
    assert "--resume" not in str(error["hint"])
    assert list(Path("runs").glob("*.journal")) == [Path("runs/a.journal")]
    if code == "E8010":
        assert here("reset", "--ack", "1001", *BENCH).exit_code == 0


def test_a_run_without_journal_is_refused(here: Here, killed: Path) -> None:
    Path("runs/a.journal").rename("runs/b.journal")
    for run, code, words in (
        ("a", "E8050", "sim:FILE"),
        ("nobody", "E8050", "b"),
        ("runs/ledger.jsonl", "E2004", "no run file"),
    ):
        error = error_of(here("machine", "--resume", run, *BENCH, "--json"))
        assert error["code"] == code
        assert words in f"{error['message']} {error['hint']}"


def test_what_the_journal_has_is_not_said_again(
    here: Here, killed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for more in (("--profile", "cu270", "--set", "servo.reference=0.8"), ("--controller", "firmware")):
        assert ", ".join(more[::2]) in refused(here(*RESUME, *BENCH, *more), "E2050")
    assert error_of(here(*MACHINE, "--homed", "--json"))["code"] == "E2050"
    monkeypatch.setenv("EDMCTL_PROFILE", "cu150")
    assert here(*RESUME, *BENCH, "--dry-run").exit_code == 0


@pytest.mark.slow
def test_an_array_is_taken_up_whose_finished_holes_were_not_judged_yet(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Estimated holes wait for the next touch; a host that is killed before it leaves them without a verdict."""
    shallow = ("--set", "target.depth_um=8", "--set", 'log.pulses="off"')
    killed = tmp_path / "killed"
    with at_time_of_cut(150.0, snapshot_and_stop(Path.cwd(), killed)):
        machine = ("machine", "--profile", ARRAY, *shallow, *BENCH)
        assert here(*machine, "--seed", "5", "--run-id", "a", "--quiet").exit_code == 130
    monkeypatch.chdir(killed)
    made = read_journal(Path("runs/a.journal")).state["done"]
    assert len(made) >= 2  # type: ignore[arg-type]
    assert any(not isinstance(site["verdict"], str) for site in made)  # type: ignore[attr-defined]
    assert len(done(here(*RESUME, *BENCH))["sites"]) == 9


@pytest.mark.parametrize("how", ["stopped", "killed"])
def test_an_interrupted_job_reaches_its_depth_as_forecast(here: Here, left: Left, how: str) -> None:
    shutil.copytree(getattr(left, how), Path.cwd(), dirs_exist_ok=True)
    before = read_journal(Path("runs/a.journal")).state
    assert before["begun"]
    assert 0.0 < float(before["depth_um"]) < TARGET_UM  # type: ignore[arg-type]
    dry = here(*RESUME, *BENCH, "--dry-run").document["result"]["forecast"]
    whole = here(*MACHINE, "--dry-run", "--json").document["result"]["forecast"]
    said = here(*RESUME, *BENCH)
    assert_on_target(said)
    (site,) = said.document["result"]["sites"]
    assert said.document["run_file"] == "runs/a-r1.h5"
    left_s = site["machining_time_s"] - float(before["machining_time_s"])  # type: ignore[arg-type]
    assert dry["machining_time_s"] < whole["machining_time_s"]
    assert dry["machining_time_s"] == pytest.approx(left_s, rel=0.2)
    with open_run(Path("runs/a-r1.h5")) as run:
        assert (run.text("/entry/parent_run"), run.text("/entry/status")) == ("a", "done")
        (row,) = run.table("/entry/results")
        assert float(row["depth"]) == pytest.approx(site["depth_um"], abs=0.001)
    assert list(Path("runs").glob("*.journal")) == []
    assert Path("runs/a.h5" if how == "stopped" else "runs/a.h5.partial").exists()
    again = here(*RESUME, *BENCH)
    assert (again.exit_code, error_of(again)["code"]) == (8, "E8051")
    assert "a-r1.h5" in str(error_of(again)["message"])


def test_a_run_has_several_names_and_a_dry_run_touches_nothing(here: Here, killed: Path) -> None:
    before = {file: file.read_bytes() for file in Path().rglob("*") if file.is_file()}
    for named in ("runs/a.h5", "runs/a.h5.partial", "runs/a.journal", "runs/a", "a"):
        said = here("machine", "--resume", named, *BENCH, "--dry-run", "--json")
        assert said.exit_code == 0
        resumed = said.document["result"]["resumed"]
        assert (resumed["run_id"], resumed["done"], resumed["left"]) == ("a", [], ["cu270-cu"])
        assert 0.0 < resumed["depth_um"] < TARGET_UM
        assert said.document["result"]["forecast"]["depth_um"] == TARGET_UM
    assert "cu270-cu was interrupted at about" in here("machine", "--resume", "a", *BENCH, "--dry-run").out
    way_on = "edmctl machine --resume a --port sim:bench.h5"
    assert f"goes on with  {way_on}" in here("run", "show", "a").out
    assert {file: file.read_bytes() for file in Path().rglob("*") if file.is_file()} == before


@pytest.mark.slow
def test_the_times_of_all_runs_of_a_job_add_up(here: Here, killed: Path) -> None:
    before = read_journal(Path("runs/a.journal")).state
    earlier_s, cut_s = float(before["time_s"]), float(before["machining_time_s"])  # type: ignore[arg-type]
    with at_time_of_cut(6.0, stop):
        assert here(*RESUME, *BENCH).exit_code == 130
    between = read_journal(next(Path("runs").glob("*.journal"))).state
    said = here(*RESUME, *BENCH)
    result = said.document["result"]
    (site,) = result["sites"]
    assert cut_s > 4.0
    assert result["machining_time_s"] == pytest.approx(site["machining_time_s"], abs=0.01)
    assert result["machining_time_s"] > between["job_machining_time_s"] + 1.0 > cut_s + 2.0  # type: ignore[operator]
    assert result["earlier_time_s"] == pytest.approx(between["time_s"])
    assert earlier_s < result["earlier_time_s"] < result["time_s"]
    assert result["measuring_time_s"] == pytest.approx(result["time_s"] - result["machining_time_s"])
    assert result["measuring_time_s"] > 0.0
    assert 0.0 <= result["pause_s"] < 2.0  # the tool of a killed job retracts
    ended = [
        line.entry.time_s for line in Ledger.open(Path("runs")).lines if isinstance(line.entry, RunEnded)
    ]
    assert ended[-1] == pytest.approx(result["time_s"] - result["earlier_time_s"])
    with open_run(Path("runs/a-r2.h5")) as run:
        assert run.number("/entry/parent_time") == pytest.approx(between["time_s"])
    shown = here("run", "show", "runs/a-r2.h5", "--json").document["result"]
    assert (shown["time_s"], shown["earlier_time_s"]) == (result["time_s"], result["earlier_time_s"])
    assert shown["machining_time_s"] < shown["time_s"]
    told = " ".join(here("run", "show", "runs/a-r2.h5").out.split())
    assert f"before it was taken up after a pause of {round(result['pause_s'])} s" in told, told


def test_home_is_where_the_journal_has_it_when_the_ledger_is_older(here: Here, killed: Path) -> None:
    resumption = find_run("a", Path("runs"))
    passed_s = time.time() - read_journal(resumption.path).written_utc_s
    known = replace(job_of(load_profile(CU270, QUICK).profile, Setup()), home_um=99.0, home_age_s=30000.0)
    job, state = resumed_job(resumption, known, CALENDAR), resumption.state
    assert job.home_um == state.home_um != 0.0
    assert 0.0 <= state.home_age_s < 300.0
    assert REPORT_DELAY_S <= job.home_age_s <= REPORT_DELAY_S + state.home_age_s + passed_s + 60.0


def test_a_stopped_job_keeps_the_times_of_its_end(left: Left) -> None:
    state = read_journal(left.stopped / "runs/a.journal").state
    with open_run(left.stopped / "runs/a.h5") as run:
        summary = run.summary() or {}
        (row,) = run.table("/entry/results")
    assert state["time_s"] == pytest.approx(summary["time_s"], abs=0.5)
    assert state["job_machining_time_s"] == pytest.approx(summary["machining_time_s"])
    assert state["depth_um"] == pytest.approx(float(row["depth"]), abs=0.01)
    assert (row["depth_basis"], row["verdict"]) == (b"estimated", b"")
    ended = [line.entry for line in Ledger.open(left.stopped / "runs").lines]
    (hole,) = [entry for entry in ended if isinstance(entry, SiteMachined)]
    assert hole.status == UNFINISHED
    assert hole.depth_um == pytest.approx(float(row["depth"]), abs=0.01)
    assert hole.wear_u95_um > 0.1


@pytest.mark.slow
def test_one_that_died_before_any_touch_goes_on_with_a_worn_tool(here: Here) -> None:
    deep = (*MACHINE, "--set", "target.depth_um=110.0", *BENCH, "--seed", "4")
    assert here(*deep, "--run-id", "before", "--quiet").exit_code == 0
    with dying_at("edmctl.procedures.hole.knowledge.read_pad"):
        assert here(*MACHINE, *BENCH, "--run-id", "a", "--quiet").exit_code == 4
    assert read_journal(Path("runs/a.journal")).state["site"] == ""
    assert_on_target(here(*RESUME, *BENCH))


@pytest.mark.slow
def test_one_that_dies_between_a_cut_and_its_touch_knows_the_wear(here: Here) -> None:
    with dying_at(
        "edmctl.procedures.hole.procedure.HoleProcedure._measure",
        "edmctl.procedures.hole.procedure.HoleProcedure._estimate",
    ):
        assert here(*MACHINE, *BENCH, "--seed", "4", "--run-id", "a", "--quiet").exit_code == 4
    state = read_journal(Path("runs/a.journal")).state
    assert state["phase"] == "measuring"
    depth_um, wear_um = float(state["depth_um"]), float(state["wear_um"])  # type: ignore[arg-type]
    assert wear_um > 0.2 * depth_um > 0.0
    assert_on_target(here(*RESUME, *BENCH))


def test_a_restarted_controller_needs_somebody_who_homed_its_stages(here: Here, killed: Path) -> None:
    bench = restored_bench(read_bench(Path("bench.h5")))
    with serving(bench) as port:
        said = here(*RESUME, "--port", port)
        assert "(500.0, 0.0) µm" in refused(said, "E8057")
        assert "by hand to (500.0, 0.0) µm, 0°" in str(error_of(said)["hint"])
        done(here(*RESUME, "--port", port, "--homed"))
    (hole,) = bench.truth()
    assert abs(hole.depth_um - TARGET_UM) <= TOLERANCE_UM + 0.5


@pytest.mark.slow
def test_a_controller_that_stayed_on_needs_nobody(here: Here, killed: Path) -> None:
    bench = restored_bench(read_bench(Path("bench.h5")))
    journal = read_journal(Path("runs/a.journal"))
    job = replace(journal.job, boots=bench.controller.boot_count)
    write_journal(Path("runs/a.journal"), replace(journal, job=job))
    with serving(bench) as port:
        done(here(*RESUME, "--port", port))


@pytest.mark.slow
def test_another_job_with_the_tool_is_warned_of_what_it_ends(here: Here, left: Left) -> None:
    shutil.copytree(left.stopped, Path.cwd(), dirs_exist_ok=True)
    again = (*MACHINE, *BENCH, "--dry-run", "--json")
    changed = ("measure-wear", "--profile", CU270, "--reference", "--new-tool", *BENCH, "--dry-run", "--json")
    for command in (again, (*again, "--new-tool"), changed):
        (warned,) = (w for w in here(*command).document["warnings"] if w["code"] == "W8115")
        assert "runs/a.h5" in warned["message"]
        assert "`edmctl machine --resume a --port sim:bench.h5`" in warned["hint"]
    here(*RESUME, *BENCH)
    assert "W8115" not in here(*again).out


READ_PAD = "edmctl.procedures.hole.knowledge.read_pad"


def test_a_job_that_has_cut_nothing_is_started_again_and_hinders_no_other(here: Here) -> None:
    fault = MachineFault("made for this test", hint="Reset it.", code="E62007")
    with dying_at(READ_PAD, error=fault):
        error = error_of(here(*MACHINE, *BENCH, "--seed", "4", "--run-id", "a", "--quiet", "--json"))
    assert "--resume a" not in str(error["hint"])
    assert "start the job again" in str(error["hint"])
    assert list(Path("runs").glob("*.journal")) == []
    assert error_of(here(*RESUME, *BENCH))["code"] == "E8050"
    setup = Path("shop.toml")
    setup.write_text("[stage]\nspeed_um_s = 5000.0\n")
    machine = (*MACHINE, *BENCH, "--setup", str(setup))
    with dying_at(READ_PAD):
        assert here(*machine, "--run-id", "b", "--quiet").exit_code == 4
    assert here(*machine, "--dry-run", "--json").document["warnings"] == []
    setup.write_text("[stage]\nspeed_um_s = 4000.0\n")
    error = error_of(here("machine", "--resume", "b", "--json", *BENCH))
    nothing = "It has cut nothing: start a new job, without --resume."
    assert (error["code"], error["hint"]) == ("E8053", nothing)
    # A fresh bench keeps no journal.
    with at_time_of_cut(1.0, stop):
        assert here(*MACHINE, "--port", "sim:", "--seed", "1", "--run-id", "c", "--quiet").exit_code == 130
    assert not Path("runs/c.journal").exists()
    assert error_of(here("machine", "--resume", "c", "--json"))["code"] == "E8050"


@pytest.mark.parametrize("code", ["E4005", "E4010"])
def test_the_way_on_after_a_restart_homes_the_stages_first(here: Here, killed: Path, code: str) -> None:
    order = find_run("a", Path("runs"))
    plan = checked(order, "sim:bench.h5", 0.0)
    name = RunName("a", Path("runs/a.h5"), datetime.now(UTC))
    for homed in (False, True):
        error = LinkLost("made for this test", code=code)
        add_way_on(error, replace(plan, resumed=replace(order, homed=homed)), name)
        assert "Go on with `edmctl machine" in error.hint
        assert ("--homed" in error.hint) == (homed or code == "E4005")


@pytest.mark.parametrize(("ahead_s", "age_s"), [(-100.0, 100.0), (30.0, 0.0), (86_400.0, math.inf)])
def test_a_time_in_the_future_has_no_known_age(ahead_s: float, age_s: float) -> None:
    utc_s, bench_s = time.time() + ahead_s, 500.0 + ahead_s
    assert CALENDAR.since_s(utc_s, bench_s) == pytest.approx(age_s, abs=5.0)
    assert Now(500.0).since_s(utc_s, bench_s) == (-ahead_s if ahead_s < 0.0 else math.inf)
    assert Now(500.0).since_s(utc_s, math.nan) == math.inf


@pytest.mark.slow
def test_a_job_that_was_stopped_before_its_first_touch_leaves_a_reference_in_the_end(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    touch = LinkMachine.touch

    def stopped(machine: LinkMachine, request: TouchRequest) -> tuple[Touch, ...]:
        stop()
        return touch(machine, request)

    with monkeypatch.context() as patch:
        patch.setattr(LinkMachine, "touch", stopped)
        assert here(*MACHINE, *BENCH, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130
    assert here(*RESUME, *BENCH).exit_code == 0
    measured = here("measure-wear", *BENCH, "--json").document["result"]
    assert abs(measured["wear_um"] - measured["truth"]["wear_um"]) <= measured["wear_u95_um"]


@pytest.mark.slow
def test_a_run_that_is_stopped_before_it_looks_forgets_nothing(
    here: Here, left: Left, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(left.stopped, Path.cwd(), dirs_exist_ok=True)
    lines = Ledger.open(Path("runs")).lines
    before = history_of(lines, lines[0].serial)
    (tool,) = before.tools.values()
    assert tool.worn_um > 1.0

    def stopped(machine: LinkMachine, *, pulses: bool = True) -> None:
        arm(machine, pulses=pulses)
        stop()

    arm = LinkMachine.arm
    with monkeypatch.context() as patch:
        patch.setattr(LinkMachine, "arm", stopped)
        assert here(*RESUME, *BENCH).exit_code == 130
    after = history_of(Ledger.open(Path("runs")).lines, lines[0].serial)
    (same,) = after.tools.values()
    assert same.worn_um == pytest.approx(tool.worn_um, abs=0.5)
    assert same.worn_u95_um > 0.0
    assert same.pad_um == pytest.approx(tool.pad_um, abs=0.5)
    assert [home.um for home in after.homes] == [home.um for home in before.homes]
    assert_on_target(here(*RESUME, *BENCH))


@pytest.mark.parametrize("change", tiers('wear.remeasure="never"', slow=("wear.max_cuts=1",)))
def test_a_hole_of_one_cut_that_was_broken_off_is_finished(here: Here, change: str) -> None:
    with at_time_of_cut(INTO_THE_CUT_S, stop):
        order = (*MACHINE, "--set", change, "--set", "target.tolerance_um=6", *BENCH)
        assert here(*order, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130
    (site,) = done(here(*RESUME, *BENCH))["sites"]
    assert site["cuts"] == 2


@pytest.mark.slow
def test_cuts_that_came_to_their_end_count_in_every_run(here: Here) -> None:
    few = ("wear.max_cuts=2", "wear.expected_ratio=0.7", "wear.first_fraction=0.5")
    with at_event(RunEvent.SITE_MEASURED, stop):
        order = (*MACHINE, *(word for text in few for word in ("--set", text)), *BENCH)
        assert here(*order, "--seed", "3", "--run-id", "a", "--quiet").exit_code == 130
    assert read_journal(Path("runs/a.journal")).state["cuts"] == 1
    (site,) = here(*RESUME, *BENCH).document["result"]["sites"]
    assert site["cuts"] == 2


@pytest.mark.parametrize("jump_s", tiers(-7200.0, slow=(7200.0, -3.8e8)))
def test_a_clock_that_jumps_in_mid_run_changes_nothing(
    here: Here, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    now_s = time.time
    with at_time_of_cut(INTO_THE_CUT_S, lambda: monkeypatch.setattr(time, "time", lambda: now_s() + jump_s)):
        assert_on_target(here(*MACHINE, *BENCH, "--seed", "3", "--json", "--quiet"))


def test_a_disk_that_turns_read_only_in_mid_run_ends_the_job_safely(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(_: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with at_time_of_cut(INTO_THE_CUT_S, lambda: monkeypatch.setattr(os, "fsync", read_only)):
        said = here(*MACHINE, *BENCH, "--seed", "3", "--run-id", "a", "--json", "--quiet")
    assert said.exit_code == 9, said.out
    assert "Read-only file system" in str(error_of(said)["message"])
