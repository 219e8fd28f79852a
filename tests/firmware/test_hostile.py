"""Boards, machines and hosts at their worst: no spark, step or feed that nobody asked for or watches."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np
import pytest

from edmctl.core.build import REALS
from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.simulator import BenchConfig, gap_monitor, open_bench
from edmctl.simulator.commands import REBOOT_MAGIC
from edmctl.simulator.controller_kernel import judge_tick
from edmctl.simulator.controller_state import (
    DISPLACEMENT_FAILED_UM,
    FAULT_GENERATOR,
    FAULT_NO_SPARK,
    NORMAL,
    NOTHING,
    OPEN,
    PACK,
    LoopState,
    Settings,
)
from edmctl.simulator.gap_monitor import rest_gap, wait_for_pulse
from edmctl.simulator.plant_interface import Readings
from edmctl.simulator.sequences import watch_cut
from edmctl.simulator.servo import hold_at_limit
from tests.firmware.cuts import cut
from tests.firmware.test_garbage import SANITIZERS, program
from tests.firmware_tools import build_with_sanitizers, need_package
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.core.build import Build
    from edmctl.simulator import VirtualBench

Measure: TypeAlias = "Callable[[Settings, LoopState, Readings, int], int]"
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
    build_with_sanitizers(command)
    done = subprocess.run([command[-1], "7", "60000", str(odds)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


@pytest.fixture
def measure(monkeypatch: pytest.MonkeyPatch) -> Measure:
    """The virtual controller's look at a millisecond with pulses, not compiled."""
    monkeypatch.setattr(gap_monitor, "note_sparks", gap_monitor.note_sparks.py_func)  # type: ignore[attr-defined]
    return cast("Measure", gap_monitor.measure_gap.py_func)  # type: ignore[attr-defined]


def _fails(bench: VirtualBench, part: str, name: str, value: float) -> None:
    owner = bench.plant.unit if part == "unit" else bench.plant
    setattr(owner, name, value)


@pytest.mark.parametrize("controller", ["python", "firmware"])
@pytest.mark.parametrize(
    ("part", "name", "value", "state", "fault"),
    [
        ("unit", "sensor_gain", math.nan, m.State.FAULT, 2001),
        ("unit", "sensor_gain", -math.inf, m.State.FAULT, 2001),
        ("unit", "sensor_drift_um_s", -1e9, m.State.FAULT, 2001),
        ("unit", "monitor_gain", math.nan, m.State.FAULT, 2003),
        ("unit", "monitor_gain", -math.inf, m.State.FAULT, 2003),
        ("unit", "off_time_a", math.nan, m.State.FAULT, 3004),
        ("unit", "off_time_a", -math.inf, m.State.FAULT, 3004),
        ("plant", "dielectric_flow_lpm", math.nan, m.State.FAULT, 4003),
        ("plant", "dielectric_flow_lpm", -math.inf, m.State.FAULT, 4003),
        ("plant", "dielectric_temperature_c", math.nan, m.State.FAULT, 4003),
        ("plant", "dielectric_temperature_c", -math.inf, m.State.FAULT, 4003),
    ],
)
def test_a_reading_that_cannot_be_ends_the_cut(
    core: Build, controller: str, part: str, name: str, value: float, state: m.State, fault: int
) -> None:
    bench = cut(controller, 0.1)
    assert bench.plant.drive.pulses_on
    _fails(bench, part, name, value)
    bench.controller.advance(2)
    assert not bench.plant.drive.pulses_on
    assert (bench.controller.state, bench.controller.fault) == (state, fault)


def test_black_box_and_telemetry_tell_the_charge_of_every_millisecond() -> None:
    """Of the virtual controller; hostile.c tries the core. A pulse of 3 ms is told in its last one."""
    bench = cut("python", 0.1)
    c = bench.python_controller
    (settings, loop), (drive, readings) = (c.settings, c.loop), (bench.plant.drive, bench.plant.readings)
    shared = settings.shared[0], loop.shared[0], drive.shared[0], readings.shared[0]
    c.telemetry.flush()
    for charge_uc, pulses in ((7.0, 0), (11.0, 0), (13.0, 1), (math.nan, 0)):
        readings.charge_uc, readings.pulses = charge_uc, pulses
        readings.tick += 1
        t = c.telemetry
        assert judge_tick(*shared, c.black_box.ring, t.samples, t.blocks, t.pulses) == NOTHING
    total = c.black_box.read(0, c.tick, c.boot_tick).total
    read = c.black_box.read(total - 4, c.tick, c.boot_tick)
    kept = np.frombuffer(bytes(read.records), m.Tlm.record_dtype())
    assert kept["current_a"].tolist() == [7, 11, 13, 0]  # mA
    assert kept.tobytes() == c.telemetry.samples[:4].tobytes()


@pytest.mark.parametrize("controller", ["python", "firmware"])
@pytest.mark.parametrize(("leak_a", "fault"), [(0.0, 0), (5.0, 3004), (math.nan, 3004), (-math.inf, 3004)])
def test_current_in_the_off_time_of_an_open_gap_is_found(
    core: Build, controller: str, leak_a: float, fault: int
) -> None:
    bench = cut(controller, 0.1)
    bench.plant.tool_lost_um = 1e4
    bench.plant.set_surface()
    bench.controller.advance(5)
    assert bench.plant.readings.charge_uc == 0.0
    bench.plant.unit.off_time_a = leak_a
    bench.controller.advance(5)
    assert bench.controller.fault == fault


@pytest.mark.parametrize(
    ("charge_uc", "siemens", "fault"),
    [(-2.1, 0.0, FAULT_GENERATOR), (-1.9, 0.0, NOTHING), (0.0, 5.0, FAULT_GENERATOR), (20.0, 0.006, NOTHING)],
)
def test_a_current_sensor_turned_round_hides_nothing(
    measure: Measure, charge_uc: float, siemens: float, fault: int
) -> None:
    """Of the virtual controller; hostile.c tries the core."""
    loop, settings, readings = LoopState(), Settings(), Readings()
    settings.duty_v, settings.misreads_max, settings.arc_run_max = 12.0, 50, 60
    settings.over_current, settings.nominal_siemens, settings.short_ticks_max = 1.5, 0.006, 3000
    readings.gap_v, readings.pulses, loop.tick_counts = 10.0, 2, 2 << PACK * NORMAL
    readings.charge_uc, readings.generator_siemens = charge_uc, siemens
    assert measure(settings, loop, readings, 0) == fault


@pytest.mark.parametrize("beyond_um", [-100.0, 0.0, 10.0, 100.0, DISPLACEMENT_FAILED_UM])
def test_a_short_beyond_the_limit_of_a_scan_goes_back_as_fast_as_any(beyond_um: float) -> None:
    """Of the virtual controller; hostile.c tries the core."""
    loop, settings = LoopState(), Settings()
    settings.back_um_s, settings.v_per_um = 5.0, 1.0
    loop.slow_displacement_um = beyond_um
    hold = hold_at_limit.py_func  # type: ignore[attr-defined]
    loop.rate_v_s = -50.0
    hold(settings, loop)
    assert loop.rate_v_s == -50.0
    loop.rate_v_s = 5.0
    hold(settings, loop)
    assert loop.rate_v_s == max(-5.0, min(5.0, -4.0 * beyond_um))


def test_what_counts_as_a_spark_and_as_its_place(measure: Measure) -> None:
    """Of the virtual controller; hostile.c tries the core."""
    loop, settings, readings = LoopState(), Settings(), Readings()
    settings.duty_v, settings.misreads_max, settings.arc_run_max = 12.0, 50, 60
    readings.gap_v, readings.pulses = 10.0, 2
    settings.pulse_period_ns = 434_783
    places = []
    for displacement_um, slow_um in (
        (7.0, 6.5),
        (DISPLACEMENT_FAILED_UM, 6.5),
        (8.0, 6.5),
        (108.0, 6.5),  # a single reading
        (8.5, 6.5),
        (13.0, -40.0),  # back from a jump the slow one lags
    ):
        loop.displacement_um, loop.slow_displacement_um = displacement_um, slow_um
        loop.tick_counts = 2 << PACK * NORMAL
        assert measure(settings, loop, readings, 0) == NOTHING
        places.append(loop.last_spark_um)
    assert places == [7.0, 7.0, 8.0, 13.0, 8.5, 13.0]
    for open_pulses, gap_v, open_ticks in ((2, 11.5, 1), (2, 12.0, 2), (1, 11.999, 0)):
        loop.tick_counts = open_pulses + (2 - open_pulses << PACK * NORMAL)
        readings.gap_v, loop.slow_displacement_um = gap_v, 13.0
        assert measure(settings, loop, readings, 0) == NOTHING
        assert loop.open_ticks == open_ticks


@pytest.mark.parametrize(("apart_ms", "lost"), [(90, True), (15, True), (14, False)])
@pytest.mark.parametrize("spike_um", [0.0, 100.0])
def test_sparks_by_themselves_do_not_let_the_tool_go_on(
    measure: Measure, apart_ms: int, lost: bool, spike_um: float
) -> None:
    """Of the virtual controller; hostile.c tries the core. A tool feeds at 50 µm/s through a gap without work."""
    loop, settings, readings = LoopState(), Settings(), Readings()
    settings.duty_v, settings.misreads_max, settings.arc_run_max = 12.0, 50, 60
    settings.short_ticks_max, settings.open_ticks_max, settings.open_lost_um = 3000, 10_000, 15.0
    settings.pulse_period_ns = 434_783
    readings.gap_v, readings.pulses, loop.time_ticks, loop.z_limit_um = 10.0, 2, 60_000, 1e4
    watch = watch_cut.py_func  # type: ignore[attr-defined]
    for ms in range(1, 4000):
        z_um = 0.05 * ms
        sparks = ms % apart_ms == 0
        loop.displacement_um, loop.slow_displacement_um = z_um + (spike_um if sparks else 0.0), z_um - 2.5
        loop.tick_counts = 1 + (1 << PACK * NORMAL) if sparks else 2
        assert measure(settings, loop, readings, 0) == NOTHING
        if watch(settings, loop) == FAULT_NO_SPARK:
            assert lost
            assert z_um < 15.0 + 2.5 + 0.1
            return
    assert not lost


@pytest.mark.parametrize(("period_ms", "share"), [(1, 0.05), (10, 0.2), (100, 0.2), (1000, 0.7)])
def test_sparse_sparks_are_sparks(measure: Measure, period_ms: int, share: float) -> None:
    """Of the virtual controller: of slow pulses some ignite, by chance, while the tool feeds at 1 µm/s."""
    loop, settings, readings, random = LoopState(), Settings(), Readings(), Random(5)
    settings.duty_v, settings.misreads_max, settings.arc_run_max = 12.0, 50, 60
    settings.short_ticks_max, settings.open_ticks_max, settings.open_lost_um = 3000, 10_000, 15.0
    settings.pulse_period_ns = period_ms * 1_000_000
    readings.gap_v, readings.pulses, loop.time_ticks, loop.z_limit_um = 10.0, 1, 10**9, 1e9
    watch = watch_cut.py_func  # type: ignore[attr-defined]
    for ms in range(0, 2000 * period_ms, period_ms):
        loop.displacement_um = loop.slow_displacement_um = 0.001 * ms
        loop.tick_counts = 1 << PACK * (NORMAL if random.random() < share else OPEN)
        loop.silent_ticks = period_ms - 1
        assert measure(settings, loop, readings, 0) == NOTHING
        assert watch(settings, loop) == NOTHING, ms


@pytest.mark.parametrize("controller", ["python", "firmware"])
def test_what_no_count_can_tell_is_told_by_a_limit(core: Build, controller: str) -> None:
    bench = cut(controller, 0.1)
    bench.plant.unit.gap_stuck_v = 900.0
    bench.controller.advance(100)
    bench.plant.unit.monitor_gain = math.nan
    bench.controller.advance(1)
    bench.controller.link.take_output()
    hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 77, m.SCHEMA_HASH)
    for at, request in enumerate((hello, m.GetStatus())):
        bench.controller.receive(encode_frame(request.ID, at, 5, 0, request.pack()))
    told = FrameDecoder(watch_for_abort=False).feed(bench.controller.link.take_output())
    status = m.GetStatusReply.unpack(told[-1].payload)
    assert bench.controller.loop.gap_v > 400.0
    assert (status.gap_v, status.monitor_v) == (327.675, -327.68)


@pytest.mark.parametrize("controller", ["python", "firmware"])
def test_damaged_frames_count_from_the_reset_on(core: Build, controller: str) -> None:
    bench = open_bench(BenchConfig(controller=controller), 1)
    bench.controller.receive(b"\0damaged\0" * 12)
    bench.controller.reset(m.ResetCause.EXTERNAL)
    hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 1, m.SCHEMA_HASH)
    frames = [encode_frame(r.ID, at, 5, 0, r.pack()) for at, r in enumerate((hello, m.Arm(m.param_crc({}))))]
    bench.controller.receive(b"".join(frames) + b"\0damaged\0" * 10)
    assert bench.controller.fault == 1003


@pytest.mark.parametrize("controller", ["python", "firmware"])
@pytest.mark.parametrize(("damaged", "fault"), [(9, 0), (10, 1003)])
def test_damaged_frames_before_a_reset_count_no_more(
    core: Build, controller: str, damaged: int, fault: int
) -> None:
    """Though the next host arms in the very call in which it comes."""
    bench = open_bench(BenchConfig(controller=controller), 1)
    for nonce, count in ((1, 9), (2, damaged)):
        hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, nonce, m.SCHEMA_HASH)
        requests = (hello, m.Arm(m.param_crc({})))
        frames = [encode_frame(r.ID, at, 5, 0, r.pack()) for at, r in enumerate(requests)]
        bench.controller.receive(b"".join(frames) + b"\0damaged\0" * count)
        if nonce == 1:
            bench.controller.reset(m.ResetCause.EXTERNAL)
    assert bench.controller.fault == fault


@pytest.mark.parametrize("controller", ["python", "firmware"])
@pytest.mark.parametrize(("apart_ms", "fault"), [(1233, 1003), (1234, 0)])
def test_a_second_of_the_host_is_whole_milliseconds_of_the_controller(
    core: Build, controller: str, apart_ms: int, fault: int
) -> None:
    """At 1.2345 times the pace of the host a second of it is 1234 ms."""
    bench = open_bench(BenchConfig(controller=controller), 1)
    bench.controller.host_time_scale = 1.2345
    hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 1, m.SCHEMA_HASH)
    requests = (hello, m.Arm(m.param_crc({})))
    bench.controller.receive(
        b"".join(encode_frame(r.ID, at, 5, 0, r.pack()) for at, r in enumerate(requests))
    )
    bench.controller.receive(b"\0damaged\0" * 9)
    for _ in range(apart_ms):
        bench.controller.advance(1)
        bench.controller.host_heard()
    bench.controller.receive(b"\0damaged\0")
    assert bench.controller.fault == fault


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
    need_package("ziglang")
    page = (ROOT / "docs/firmware.md").read_text(encoding="utf-8")
    (typed,) = re.findall(r"^ +python (-m ziglang cc .*?) -o board.elf$", page, re.DOTALL | re.MULTILINE)
    made = tmp_path / "board.elf"
    more = f"-Wdouble-promotion -Werror -s -o {shlex.quote(str(made))}"
    command = f"{shlex.quote(sys.executable)} {typed} {more}"
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert made.stat().st_size < 48 * 1024  # with the compiler's own checks it is more than ten times that


def test_pulses_of_a_generator_that_does_not_switch_off_are_found() -> None:
    """Of the virtual controller; hostile.c tries the core."""
    loop, readings = LoopState(), Readings()
    loop.watched, readings.gap_v = 1, math.nan
    rest = rest_gap.py_func  # type: ignore[attr-defined]
    for name in ("pulses", "stray_pulses"):
        found = []
        for count in (1, 0, 3, 3):
            setattr(readings, name, count)
            found.append(rest(loop, readings))
        assert found == [NOTHING, NOTHING, NOTHING, FAULT_GENERATOR]
        setattr(readings, name, 0)
        assert rest(loop, readings) == NOTHING


@pytest.mark.parametrize("value", [math.nan, 700.0, -700.0, 1e9])
@pytest.mark.parametrize("part", ["gap", "flow", "temperature", "monitor", "sensor"])
def test_both_controllers_tell_readings_beyond_the_wire_alike(core: Build, part: str, value: float) -> None:
    said = []
    for controller in ("python", "firmware"):
        heard = bytearray()
        bench = cut(controller, 0.05, heard=heard)
        replies = [f for f in FrameDecoder(watch_for_abort=False).feed(bytes(heard)) if f.type_id & 0x40]
        plant, unit = bench.plant, bench.plant.unit
        owner, name = {
            "gap": (unit, "gap_stuck_v"),
            "flow": (plant, "dielectric_flow_lpm"),
            "temperature": (plant, "dielectric_temperature_c"),
            "monitor": (unit, "monitor_zero_v"),
            "sensor": (unit, "sensor_bend_um"),
        }[part]
        setattr(owner, name, value)
        bench.controller.advance(60)
        ask = encode_frame(m.GetStatus.ID, replies[-1].seq + 100 & 255, replies[-1].session, 0, b"")
        bench.controller.receive(ask)
        said.append((bench.controller.link.take_output(), bench.controller.fault))
    assert said[0] == said[1]


@pytest.mark.parametrize("controller", ["python", "firmware"])
def test_an_abort_run_behind_a_reboot_is_latched_and_no_command(core: Build, controller: str) -> None:
    bench = open_bench(BenchConfig(controller=controller), 1)
    requests = (
        m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 1, m.SCHEMA_HASH),
        m.TlmStart(1000, 14, m.PulseLog.BLOCKS),
        m.Reboot(REBOOT_MAGIC),
        m.Arm(m.param_crc({})),
    )
    frames = [encode_frame(r.ID, at, 5, 0, r.pack()) for at, r in enumerate(requests)]
    bench.controller.receive(frames[0] + frames[1])
    bench.controller.advance(5)  # samples wait then that no FAULT brings
    bench.controller.receive(b"".join(frames[2:]) + bytes(8))
    assert (bench.controller.fault, bench.controller.state) == (1002, m.State.FAULT)
    told = FrameDecoder(watch_for_abort=False).feed(bench.controller.link.take_output())
    types = [f.type_id for f in told]
    assert types == [m.Hello.ID | 0x40, m.TlmStart.ID | 0x40, m.Reboot.ID | 0x40, m.Fault.ID, m.Boot.ID]
