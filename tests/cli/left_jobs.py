"""Jobs that are interrupted in the middle of a cut, and what is done to machine and clock before they go on."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from edmctl.app import main
from edmctl.machine.interface import TelemetryBlock
from edmctl.procedures.run import MACHINING as MACHINING_PHASE
from edmctl.procedures.run import JobRun, JobStateKeeper
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.record.journal import Journal, read_journal
from edmctl.record.rows import RunEvent
from edmctl.simulator import VirtualBench
from edmctl.simulator.saving import bench_state, restored_bench
from edmctl.simulator.work_under_tool import TILE
from tests.cli.commands import CU270, Here, Said
from tests.golden import once

QUICK = (
    'target={kind="depth",depth_um=24.0,tolerance_um=1.5}',
    'jump.mode="off"',
    "approach.speed_um_s=4.0",
    "measure.settle_s=0.2",
    "measure.touches=2",
    "pulse.current_a=0.5",
    'log.pulses="off"',
)
TARGET_UM, TOLERANCE_UM = 24.0, 1.5
MACHINE = ("machine", "--profile", CU270, *(word for text in QUICK for word in ("--set", text)))
BENCH = ("--port", "sim:bench.h5")
RESUME = ("machine", "--resume", "a", "--json", "--quiet")


@contextmanager
def at_time_of_cut(seconds: float, act: Callable[[], object]) -> Iterator[None]:
    """Do something once when a cut has gone on for so long."""
    began_s: list[float] = []

    def is_time(journal: JobStateKeeper, block: TelemetryBlock) -> bool:
        if journal.phase != MACHINING_PHASE:
            return False
        began_s.append(float(block.time_s[0]))
        return float(block.time_s[-1]) - began_s[0] > seconds

    with _once(is_time, act):
        yield


@contextmanager
def at_time_of_run(seconds: float, act: Callable[[], object]) -> Iterator[None]:
    """Do something once when a job has gone on for so long."""
    with _once(lambda _, block: float(block.time_s[-1]) > seconds, act):
        yield


@contextmanager
def at_event(code: RunEvent, act: Callable[[], object]) -> Iterator[None]:
    """Do something when a job decides this."""
    decide = JobRun.decide

    def watched(run: JobRun, decided: RunEvent, *args: Any, **more: Any) -> None:
        decide(run, decided, *args, **more)
        if decided is code:
            act()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JobRun, "decide", watched)
        yield


@contextmanager
def _once(
    is_time: Callable[[JobStateKeeper, TelemetryBlock], bool], act: Callable[[], object]
) -> Iterator[None]:
    take, done = JobStateKeeper.on_telemetry, False

    def watched(journal: JobStateKeeper, block: TelemetryBlock) -> None:
        nonlocal done
        take(journal, block)
        if not done and is_time(journal, block):
            done = True
            act()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JobStateKeeper, "on_telemetry", watched)
        yield


def stop() -> None:
    """Be a person who presses Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)


def snapshot_and_stop(home: Path, snapshot: Path) -> Callable[[], None]:
    """Return what stops the job; what a killed process would have left, the disk at that instant, is kept."""

    def act() -> None:
        shutil.copytree(home, snapshot)
        stop()

    return act


def killed_at(
    factory: pytest.TempPathFactory, name: str, order: tuple[str, ...], seconds: Sequence[float]
) -> dict[float, Path]:
    """One job on a kept bench, and what its folder would hold had it been killed so long after its cut began.

    The job is golden: it is run once, its folder is copied at each of the times, and a stop ends it at the last one.
    """

    def make(golden: Path) -> None:
        home, times_s = golden / "home", sorted(seconds)
        home.mkdir()
        with ExitStack() as stack:
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            for variable in ("EDMCTL_PROFILE", "EDMCTL_PORT", "EDMCTL_CALIBRATION"):
                patch.delenv(variable, raising=False)
            patch.setenv("EDMCTL_HOME", str(golden / "user"))
            patch.chdir(home)
            for at_s in times_s:
                stack.enter_context(
                    at_time_of_cut(at_s, partial(shutil.copytree, home, golden / f"{at_s:g}"))
                )
            stack.enter_context(at_time_of_cut(times_s[-1], stop))
            stack.enter_context(redirect_stdout(StringIO()))
            assert main([*order, *BENCH, "--run-id", "a", "--quiet"]) == 130

    golden = once(factory, name, make)
    return {at_s: golden / f"{at_s:g}" for at_s in seconds}


def taken_over(killed: Path) -> Journal:
    """Copy what a killed job has left into the folder of the test; the journal that reached the disk."""
    shutil.copytree(killed, Path.cwd(), dirs_exist_ok=True)
    return read_journal(Path("runs/a.journal"))


def bench_changed(change: Callable[[VirtualBench], None]) -> None:
    """Do something to the machine of the bench file while no command runs."""
    bench = restored_bench(read_bench(Path("bench.h5")))
    change(bench)
    write_bench(Path("bench.h5"), bench_state(bench))


def swap_work(bench: VirtualBench) -> None:
    """Put in a board that nobody has cut."""
    ground = bench.plant.work_under_tool
    bench.plant.leave()
    ground.holes.clear()
    ground.work.tiles.clear()
    bench.plant.arrive()


def move_work(bench: VirtualBench) -> None:
    """Clamp the board anew, half a millimetre further along x: the stages tell the places that they told before."""
    ground = bench.plant.work_under_tool
    bench.plant.leave()
    tiles_on = round(500.0 / (TILE * ground.work.cell_um))
    ground.work.tiles = {
        (column + tiles_on, row): cells for (column, row), cells in ground.work.tiles.items()
    }
    for hole in ground.holes:
        hole.x_um += tiles_on * TILE * ground.work.cell_um
    bench.plant.arrive()


def lengthen_tool(way_um: float) -> Callable[[VirtualBench], None]:
    """Return what seats the tool anew, so much further out: nothing but its length tells."""

    def change(bench: VirtualBench) -> None:
        bench.plant.state.wear_um -= way_um
        bench.plant.arrive()

    return change


def error_of(said: Said) -> dict[str, object]:
    """The error of a JSON object; it has a hint."""
    error: dict[str, object] = said.document["error"]
    assert error["hint"], error
    return error


def worn_um() -> float:
    """What the virtual tool has lost by now."""
    return restored_bench(read_bench(Path("bench.h5"))).tool_wear_um


def done(said: Said) -> dict[str, Any]:
    """The result of a command that has reached what it was for."""
    assert said.exit_code == 0, said.out
    result: dict[str, Any] = said.document["result"]
    return result


KEPT_STATE = (
    "site",
    "begun",
    "depth_um",
    "depth_u_um",
    "wear_um",
    "wear_u_um",
    "feed_u_um",
    "counts",
    "channel",
)


def refused(here: Here, code: str, *more: str) -> str:
    """Go on, and return the words of a refusal that has sparked nothing and leaves a journal of the same hole."""
    (before,) = Path("runs").glob("*.journal")
    state, worn_before_um = read_journal(before).state, worn_um()
    said = here(*RESUME, *more, *BENCH)
    error = error_of(said)
    assert (error["code"], said.exit_code) == (code, 8), error
    assert worn_um() == worn_before_um
    # What the journal estimates of a hole that is not there is no result of this run.
    if (result := said.document["result"]) is not None:
        assert state["site"] not in [site["name"] for site in result["sites"]]
        assert result["reached"] is None
    (after,) = Path("runs").glob("*.journal")
    for name in KEPT_STATE:
        assert read_journal(after).state.get(name) == state.get(name), name
    after.rename("runs/a.journal")
    return f"{error['message']} {error['hint']}"
