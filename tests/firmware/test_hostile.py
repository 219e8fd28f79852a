"""Boards, machines and hosts at their worst: no spark, step or feed that nobody asked for or watches."""

from __future__ import annotations

import importlib.util
import math
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from edmctl.firmware.build import REALS
from edmctl.link import messages as m
from edmctl.simulator.controller_state import FAULT_NO_SPARK, NOTHING, LoopState, Settings
from edmctl.simulator.gap_monitor import wait_for_pulse
from tests.firmware.cuts import cut
from tests.firmware.test_garbage import SANITIZERS, program
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.firmware.build import Build
    from edmctl.simulator import VirtualBench

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("real", tiers("float", slow=("double",)))
def test_failed_readings_and_words_end_safe(core: Build, real: str, tmp_path: Path) -> None:
    """The cases of hostile.c: each failed reading in a cut, a dead generator, a reset at 150 V, lost words."""
    command = program("hostile", real, tmp_path)
    subprocess.run(command, check=True)
    done = subprocess.run([command[-1]], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "0 broken\n")


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("odds", tiers(slow=(50, 2000), full=(10, 10**9)))
def test_random_work_on_a_failing_board_stays_safe(core: Build, real: str, odds: int, tmp_path: Path) -> None:
    command = program("hostile", real, tmp_path, SANITIZERS, "-fno-sanitize-recover=all")
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("the C compiler has no sanitizers")
    done = subprocess.run([command[-1], "7", "60000", str(odds)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


def _fails(bench: VirtualBench, part: str, name: str, value: float) -> None:
    owner = bench.plant.unit if part == "unit" else bench.plant
    setattr(owner, name, value)


@pytest.mark.parametrize("controller", ["python", "firmware"])
@pytest.mark.parametrize(
    ("part", "name", "state", "fault"),
    [
        ("unit", "sensor_gain", m.State.ARMED, 0),
        ("unit", "monitor_gain", m.State.FAULT, 2003),
        ("unit", "off_time_a", m.State.FAULT, 3004),
        ("plant", "dielectric_flow_lpm", m.State.FAULT, 4003),
        ("plant", "dielectric_temperature_c", m.State.FAULT, 4003),
    ],
)
def test_a_reading_that_is_no_number_ends_the_cut(
    core: Build, controller: str, part: str, name: str, state: m.State, fault: int
) -> None:
    bench = cut(controller, 0.1)
    assert bench.plant.drive.pulses_on
    _fails(bench, part, name, math.nan)
    bench.controller.advance(2)
    assert not bench.plant.drive.pulses_on
    assert (bench.controller.state, bench.controller.fault) == (state, fault)


def test_a_reset_beyond_the_default_range_makes_no_jump() -> None:
    """Of the virtual controller; hostile.c tries the core."""
    bench = cut("python", 0.0)
    bench.controller.loop.command_v = 149.0
    bench.controller.reset(m.ResetCause.WATCHDOG)
    bench.controller.advance(1)
    assert bench.controller.loop.command_v == pytest.approx(149.0 - 0.337)
    bench.controller.advance(500)
    assert bench.controller.loop.command_v == 0.0


def test_a_dead_generator_is_no_open_gap() -> None:
    """Of the virtual controller; hostile.c tries the core."""
    loop, settings = LoopState(), Settings()
    settings.pulse_period_ns = 434_783
    wait = wait_for_pulse.py_func  # type: ignore[attr-defined]
    waits = [wait(settings, loop) for _ in range(101)]
    assert waits == [NOTHING] * 100 + [FAULT_NO_SPARK]


@pytest.mark.slow
def test_the_core_builds_for_a_board_without_headers_or_doubles(core: Build, tmp_path: Path) -> None:
    """docs/firmware.md: zig alone is enough, and the core does no arithmetic in double."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is not installed")
    page = (ROOT / "docs/firmware.md").read_text(encoding="utf-8")
    (typed,) = re.findall(r"^ +python (-m ziglang cc .*?) -o board.elf$", page, re.DOTALL | re.MULTILINE)
    made = tmp_path / "board.elf"
    more = f"-Wdouble-promotion -Werror -s -o {shlex.quote(str(made))}"
    command = f"{shlex.quote(sys.executable)} {typed} {more}"
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert made.stat().st_size < 48 * 1024  # with the compiler's own checks it is more than ten times that
