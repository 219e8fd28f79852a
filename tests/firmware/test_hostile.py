"""Boards, machines and hosts at their worst: no spark, step or feed that nobody asked for or watches."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from edmctl.core.build import REALS
from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.wire import Request
from edmctl.simulator import BenchConfig, open_bench
from tests.firmware.cuts import cut
from tests.firmware.test_garbage import SANITIZERS, program
from tests.needs import build_with_sanitizers
from tests.tiers import tiers

REBOOT_MAGIC = 0x0B007EDB
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("real", tiers("float", slow=("double",)))
@pytest.mark.expensive("compiles the core")
def test_failed_readings_and_words_end_safe(real: str, tmp_path: Path) -> None:
    """The cases of hostile.c: each failed reading in a cut, a dead generator, a reset at 150 V, lost words."""
    command = program("hostile", real, tmp_path, "-O0")
    subprocess.run(command, check=True)
    done = subprocess.run([command[-1]], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "0 broken\n")


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("odds", tiers(slow=(50, 2000), full=(10, 10**9)))
def test_random_work_on_a_failing_board_stays_safe(real: str, odds: int, tmp_path: Path) -> None:
    command = program("hostile", real, tmp_path, SANITIZERS, "-fno-sanitize-recover=all")
    build_with_sanitizers(command)
    done = subprocess.run([command[-1], "7", "60000", str(odds)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


def asked(*requests: Request[Any]) -> bytes:
    """Frames of a session with these requests."""
    return b"".join(encode_frame(r.ID, at, 5, 0, r.pack()) for at, r in enumerate(requests))


def hello(nonce: int = 1) -> m.Hello:
    return m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, nonce, m.SCHEMA_HASH)


ARM = m.Arm(m.param_crc({}))


@pytest.mark.parametrize(
    ("part", "name", "value", "fault"),
    [
        ("unit", "sensor_gain", math.nan, 2001),
        ("unit", "sensor_gain", -math.inf, 2001),
        ("unit", "sensor_drift_um_s", -1e9, 2001),
        ("unit", "monitor_gain", math.nan, 2003),
        ("unit", "monitor_gain", -math.inf, 2003),
        ("unit", "off_time_a", math.nan, 3004),
        ("unit", "off_time_a", -math.inf, 3004),
        ("plant", "dielectric_flow_lpm", math.nan, 4003),
        ("plant", "dielectric_flow_lpm", -math.inf, 4003),
        ("plant", "dielectric_temperature_c", math.nan, 4003),
        ("plant", "dielectric_temperature_c", -math.inf, 4003),
    ],
)
def test_a_reading_that_cannot_be_ends_the_cut(part: str, name: str, value: float, fault: int) -> None:
    bench = cut("firmware", 0.1)
    assert bench.plant.drive.pulses_on
    setattr(bench.plant.unit if part == "unit" else bench.plant, name, value)
    bench.controller.advance(2)
    assert not bench.plant.drive.pulses_on
    assert (bench.controller.state, bench.controller.fault) == (m.State.FAULT, fault)


@pytest.mark.parametrize(("leak_a", "fault"), [(0.0, 0), (5.0, 3004), (math.nan, 3004), (-math.inf, 3004)])
def test_current_in_the_off_time_of_an_open_gap_is_found(leak_a: float, fault: int) -> None:
    bench = cut("firmware", 0.1)
    bench.plant.tool_lost_um = 1e4
    bench.plant.set_surface()
    bench.controller.advance(5)
    assert bench.plant.readings.charge_uc == 0.0
    bench.plant.unit.off_time_a = leak_a
    bench.controller.advance(5)
    assert bench.controller.fault == fault


def test_what_no_count_can_tell_is_told_by_a_limit() -> None:
    bench = cut("firmware", 0.1)
    bench.plant.unit.gap_stuck_v = 900.0
    bench.controller.advance(100)
    bench.plant.unit.monitor_gain = math.nan
    bench.controller.advance(1)
    bench.controller.link.take_output()
    bench.controller.receive(asked(hello(), m.GetStatus()))
    told = FrameDecoder(watch_for_abort=False).feed(bench.controller.link.take_output())
    status = m.GetStatusReply.unpack(told[-1].payload)
    assert bench.controller.loop.gap_v > 400.0
    assert (status.gap_v, status.monitor_v) == (327.675, -327.68)


@pytest.mark.parametrize(("damaged", "fault"), [(9, 0), (10, 1003)])
def test_damaged_frames_before_a_reset_count_no_more(damaged: int, fault: int) -> None:
    """Though the next host arms in the very call in which it comes."""
    bench = open_bench(BenchConfig(), 1)
    for nonce, count in ((1, 9), (2, damaged)):
        bench.controller.receive(asked(hello(nonce), ARM) + b"\0damaged\0" * count)
        if nonce == 1:
            bench.controller.reset(m.ResetCause.EXTERNAL)
    assert bench.controller.fault == fault


@pytest.mark.parametrize(("apart_ms", "fault"), [(1233, 1003), (1234, 0)])
def test_a_second_of_the_host_is_whole_milliseconds_of_the_controller(apart_ms: int, fault: int) -> None:
    """At 1.2345 times the pace of the host a second of it is 1234 ms."""
    bench = open_bench(BenchConfig(), 1)
    bench.controller.host_time_scale = 1.2345
    bench.controller.receive(asked(hello(), ARM) + b"\0damaged\0" * 9)
    for _ in range(apart_ms):
        bench.controller.advance(1)
        bench.controller.host_heard()
    bench.controller.receive(b"\0damaged\0")
    assert bench.controller.fault == fault


@pytest.mark.slow
@pytest.mark.needs("ziglang")
def test_the_core_builds_for_a_board_without_headers_or_doubles(tmp_path: Path) -> None:
    """docs/firmware.md: zig alone is enough, and the core does no arithmetic in double."""
    page = (ROOT / "docs/firmware.md").read_text(encoding="utf-8")
    (typed,) = re.findall(r"^ +python (-m ziglang cc .*?) -o board.elf$", page, re.DOTALL | re.MULTILINE)
    made = tmp_path / "board.elf"
    more = f"-Wdouble-promotion -Werror -s -o {shlex.quote(str(made))}"
    command = f"{shlex.quote(sys.executable)} {typed} {more}"
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert made.stat().st_size < 48 * 1024  # with the compiler's own checks it is more than ten times that


def test_an_abort_run_behind_a_reboot_is_latched_and_no_command() -> None:
    bench = open_bench(BenchConfig(), 1)
    telemetry = m.TlmStart(1000, 14, m.PulseLog.BLOCKS)
    bench.controller.receive(asked(hello(), telemetry))
    bench.controller.advance(5)  # samples wait then that no FAULT brings
    both = asked(hello(), telemetry, m.Reboot(REBOOT_MAGIC), ARM)
    bench.controller.receive(both[len(asked(hello(), telemetry)) :] + bytes(8))
    assert (bench.controller.fault, bench.controller.state) == (1002, m.State.FAULT)
    told = FrameDecoder(watch_for_abort=False).feed(bench.controller.link.take_output())
    types = [f.type_id for f in told]
    assert types == [m.Hello.ID | 0x40, m.TlmStart.ID | 0x40, m.Reboot.ID | 0x40, m.Fault.ID, m.Boot.ID]
