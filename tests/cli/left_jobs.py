"""Jobs that are interrupted in the middle of a cut, and what is done to machine and clock before they go on."""

from __future__ import annotations

import os
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from edmctl.procedures.run import JobRun
from edmctl.procedures.state_keeper import MACHINING as MACHINING_PHASE
from edmctl.procedures.state_keeper import JobStateKeeper
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.simulator import kernel as k
from edmctl.simulator.saving import bench_state, restored_bench
from edmctl.simulator.workpiece import TILE
from tests.cli.commands import CU270

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.machine.port import TelemetryBlock
    from edmctl.procedures.event_codes import RunEvent
    from edmctl.simulator import VirtualBench
    from tests.cli.commands import Said

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
def at_time_of_cut(seconds: float, act: Callable[[], None]) -> Iterator[None]:
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
def at_time_of_run(seconds: float, act: Callable[[], None]) -> Iterator[None]:
    """Do something once when a job has gone on for so long."""
    with _once(lambda _, block: float(block.time_s[-1]) > seconds, act):
        yield


@contextmanager
def at_event(code: RunEvent, act: Callable[[], None]) -> Iterator[None]:
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
    is_time: Callable[[JobStateKeeper, TelemetryBlock], bool], act: Callable[[], None]
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


def bench_changed(change: Callable[[VirtualBench], None]) -> None:
    """Do something to the machine of the bench file while no command runs."""
    bench = restored_bench(read_bench(Path("bench.h5")))
    change(bench)
    write_bench(Path("bench.h5"), bench_state(bench))


def swap_work(bench: VirtualBench) -> None:
    """Put in a board that nobody has cut."""
    ground = bench.plant.ground
    bench.plant.leave()
    ground.holes.clear()
    ground.work.tiles.clear()
    bench.plant.arrive()


def move_work(bench: VirtualBench) -> None:
    """Clamp the board anew, half a millimetre further along x: the stages tell the places that they told before."""
    ground = bench.plant.ground
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
        bench.plant.st[k.WEAR] -= way_um
        bench.plant.arrive()

    return change


def error_of(said: Said) -> dict[str, object]:
    """The error of a JSON object; it has a hint."""
    error: dict[str, object] = said.document["error"]
    assert error["hint"], error
    return error
