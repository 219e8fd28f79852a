"""A worker that makes many runs keeps none of their virtual machines."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import simulator
from edmctl.jobs.batch import Task
from edmctl.jobs.batch import perform as perform_task
from edmctl.jobs.parallel import silent_program
from edmctl.jobs.plan import JobRequest
from edmctl.simulator import VirtualBench
from edmctl.study.running import evaluate, task_of
from tests.study.studies import SMALL, made

if TYPE_CHECKING:
    import pytest


def machines_alive(make_run: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> int:
    """Return how many of the virtual machines of two runs there are when a third begins."""
    machines: list[weakref.ref[VirtualBench]] = []
    alive: list[int] = []
    open_bench = simulator.open_bench

    def opened(config: simulator.BenchConfig, seed: int) -> VirtualBench:
        alive.append(sum(machine() is not None for machine in machines))
        bench = open_bench(config, seed)
        machines.append(weakref.ref(bench))
        return bench

    monkeypatch.setattr(simulator, "open_bench", opened)
    gc.disable()
    try:
        for _ in range(3):
            make_run()
    finally:
        gc.enable()
    assert len(alive) == 3
    return alive[-1]


def test_a_series_keeps_no_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(JobRequest("cu270", ("target.depth_um=3",), None, None), 1, None, "one")
    assert machines_alive(lambda: perform_task(task, silent_program()), monkeypatch) == 0


def test_a_study_keeps_no_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = made(tmp_path, SMALL)
    task = task_of(folder, folder.read().runs[0])
    assert machines_alive(lambda: evaluate(task), monkeypatch) == 0
