"""Plant and controller know nothing of each other but two records, and anything that knows these is a controller."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import edmctl.simulator
from edmctl.actuator.compiling import cached
from edmctl.link import messages as m
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.controller_kernel import judge_tick
from edmctl.simulator.controller_state import LoopState, Settings
from edmctl.simulator.kernel import run
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_interface import Drive, Readings
from edmctl.simulator.plant_state import PlantState, Scope, Unit
from edmctl.simulator.servo import command_tick

if TYPE_CHECKING:
    from edmctl.core.records import Record

PLANT = ("discharge", "plant_kernel", "plant_state")
CONTROLLER = ("controller_kernel", "controller_state", "gap_monitor", "sequences", "servo")
BETWEEN = ("plant_interface", "records")
NEAR = BenchConfig(offset_um=5.0)


def tree_of(module: str) -> ast.Module:
    return ast.parse(Path(edmctl.simulator.__path__[0], f"{module}.py").read_text(encoding="utf-8"))


def fields(*records: type[Record]) -> set[str]:
    return {name for record in records for name in record.__annotations__}


HALVES = [
    (PLANT, fields(Unit, PlantState, Scope), fields(Settings, LoopState)),
    (CONTROLLER, fields(Settings, LoopState), fields(Unit, PlantState, Scope)),
]


@pytest.mark.parametrize(("modules", "own", "others"), HALVES, ids=["plant", "controller"])
def test_a_half_imports_nothing_of_the_other_and_names_nothing_of_its_records(
    modules: tuple[str, ...], own: set[str], others: set[str]
) -> None:
    foreign = others - own - fields(Drive, Readings)
    assert len(foreign) > 30
    for module in modules:
        for node in ast.walk(tree_of(module)):
            if isinstance(node, ast.Attribute):
                assert node.attr not in foreign, f"{module}: {node.attr}"
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("edmctl.simulator"):
                imported = (node.module or "").rpartition(".")[2]
                assert imported in (*modules, *BETWEEN), f"{module} imports {imported}"
            elif isinstance(node, ast.Import):
                assert all(alias.name == "math" for alias in node.names), module


def test_every_module_compiled_into_the_loop_belongs_to_a_half_or_between_them() -> None:
    stamp = dict(run._cache._cache_file._source_stamp)  # type: ignore[attr-defined]
    modules = {name.rpartition(".")[2] for name in stamp if name.rpartition(".")[0] == "edmctl.simulator"}
    assert modules == (
        {*PLANT, *CONTROLLER, *BETWEEN, "kernel"} - {"plant_state", "controller_state", "records"}
    )


def test_compiled_code_on_disk_is_stale_when_any_of_its_sources_or_constants_has_changed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = run._cache._cache_file._source_stamp  # type: ignore[attr-defined]
    again = cached(run.py_func)  # type: ignore[attr-defined]
    assert again._cache._cache_file._source_stamp == before
    monkeypatch.setattr("edmctl.simulator.discharge.CARBON_RUN", 21)
    changed = cached(run.py_func)  # type: ignore[attr-defined]
    assert changed._cache._cache_file._source_stamp != before


class ByHand:
    """Another controller: it steps down until the gap voltage falls, then keeps it by little steps both ways."""

    def __init__(self) -> None:
        self.pulses = 0

    def __call__(self, readings: Readings, drive: Drive) -> None:
        if not drive.pulses_on:
            drive.pulses_on = 1
            drive.pulse_starts += 1
        self.pulses += readings.pulses
        sparks = readings.pulses > 0 and min(readings.plateau_v[: readings.pulses]) < 30.0
        step_v = -0.005 if sparks and readings.gap_v < 9.6 else 0.0025
        drive.actuator_v = max(0.0, drive.actuator_v + step_v)


def test_a_plain_callable_drives_the_plant() -> None:
    plant, by_hand = Plant(NEAR, 1), ByHand()
    plant.stage_lands(0, 0.0)
    plant.advance(by_hand, 5000)
    assert plant.readings.tick == 5000
    assert by_hand.pulses == pytest.approx(5000 * 2.3, rel=0.01)
    assert plant.state.depth_um > 0.3
    assert plant.tool_wear_um > 0.05
    assert abs(plant.readings.sensor_um - plant.state.true_z_um) < 1.0


def machining() -> VirtualBench:
    """A bench in the middle of a cut, with telemetry on its way."""
    bench = open_bench(NEAR, 2)
    controller, crc = bench.python_controller, m.param_crc({})
    orders = (m.CommitProfile(crc), m.Arm(crc), m.PulseEnable(1), m.StageMove(m.Axis.X, 0, 50_000_000))
    for order in (*orders, m.TlmStart(1000, 10, m.PulseLog.FULL), m.Approach(5.0, 100.0, 10.8)):
        controller.commands.execute(order)
        for _ in range(4):
            controller.host_heard()
            controller.advance(100)
    if controller.state is not m.State.ARMED:
        controller.commands.execute(m.ServoStop())
    controller.commands.execute(m.ServoStart(9.6, 500.0, 100.0))
    controller.telemetry.flush()
    return bench


@pytest.mark.slow
def test_the_controller_sees_and_tells_nothing_past_the_interface() -> None:
    """Its two functions, called from outside, cut as they do when compiled into one loop with the plant."""
    together, apart = machining(), machining()
    together.python_controller.step(150)
    controller, plant, begun = apart.python_controller, apart.plant, False

    def judge() -> None:
        telemetry = controller.telemetry
        judge_tick(
            controller.settings.shared[0],
            controller.loop.shared[0],
            plant.drive.shared[0],
            plant.readings.shared[0],
            controller.black_box.ring,
            telemetry.samples,
            telemetry.blocks,
            telemetry.pulses,
        )

    def tick(readings: Readings, drive: Drive) -> None:
        nonlocal begun
        if begun:
            judge()
        begun = True
        command_tick(
            controller.settings.shared[0], controller.loop.shared[0], drive.shared[0], readings.shared[0]
        )

    plant.advance(tick, 150)
    judge()
    assert together.plant.state.depth_um == plant.state.depth_um > 0.0
    assert bytes(together.python_controller.loop) == bytes(controller.loop)
    assert bytes(together.plant.state) == bytes(plant.state)
    for name in ("samples", "pulses"):
        buffers = [getattr(bench.python_controller.telemetry, name) for bench in (together, apart)]
        assert np.array_equal(*buffers), name
    assert np.array_equal(together.python_controller.black_box.ring, controller.black_box.ring)
