"""What the next command finds 0.1 s after `machine` was killed while it sparked: no sparks, and why there are none.

The machine runs twenty times as fast as a real one; its watchdog of 0.25 s goes by the clock on the wall.
"""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from edmctl.jobs.connect import bench_config
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Setup
from edmctl.simulator import VirtualBench, open_bench
from tests.cli.commands import CU270, SHALLOW, Here, command, environment
from tests.serving import serving
from tests.tiers import tiers

SPEED = 20.0
AFTER_S = 0.1
SETUP = "setup.toml"


def kill_while_it_sparks(bench: VirtualBench, port: str, cwd: Path) -> None:
    host = subprocess.Popen(
        command("machine", *SHALLOW, "--port", port, "--setup", SETUP, "--run-id", "r", "--quiet"),
        cwd=cwd,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    end_s = time.monotonic() + 60.0
    while not (bench.controller.state.name == "MACHINING" and bench.plant.drive.pulses_on):
        assert host.poll() is None, host.communicate()[1]
        assert time.monotonic() < end_s
        time.sleep(0.01)
    host.kill()
    host.communicate()


@pytest.mark.parametrize("name", tiers("machine", slow=("resume",), full=("doctor", "ports", "reset")))
def test_the_next_command_finds_a_machine_that_is_safe_and_a_fault_that_says_why(
    here: Here, tmp_path: Path, name: str
) -> None:
    bench = open_bench(bench_config(load_profile(CU270, ()), Setup()), 3)
    with serving(bench, SPEED) as port:
        Path(SETUP).write_text(f'[link]\ncandidates = ["{port}"]\n', encoding="utf-8")
        arguments = {
            "machine": ("machine", *SHALLOW, "--port", port, "--out", "other", "--json"),
            "resume": ("machine", "--resume", "r", "--port", port, "--json"),
            "doctor": ("doctor", "--port", port, "--setup", SETUP, "--json"),
            "ports": ("ports", "--probe", "--setup", SETUP, "--json"),
            "reset": ("reset", "--port", port, "--json"),
        }[name]
        kill_while_it_sparks(bench, port, Path())
        time.sleep(AFTER_S)
        said = here(*arguments)
        pulses = bench.controller.loop.pulse_no
        assert bench.controller.fault == 1001
        if name == "doctor":
            (check,) = [c for c in said.document["result"]["checks"] if c["name"] == "fault"]
            assert (said.exit_code, check["status"]) == (8, "fail")
            assert "1001" in check["message"]
            assert f"reset --ack 1001 --port {port}" in check["fix"]
        elif name == "ports":
            (answer,) = [p for p in said.document["result"]["ports"] if p["device"] == port]
            assert (said.exit_code, answer["controller"]["fault_name"]) == (0, "HOST_SILENT")
        else:
            error = said.document["error"]
            assert (said.exit_code, error["code"]) == (8, "E8010")
            assert "The controller still holds fault 1001" in error["message"]
            assert f"`edmctl reset --ack 1001 --port {port}`" in error["hint"]
        assert here("reset", "--ack", "1001", "--port", port).exit_code == 0
        assert bench.controller.loop.pulse_no == pulses
        assert bench.controller.loop.command_v == 0.0
