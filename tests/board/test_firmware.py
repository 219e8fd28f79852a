"""`edmctl firmware build`, and jobs on virtual machines that the firmware's core drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from edmctl.simulator.config import CONTROLLERS, FIRMWARE, FIRMWARE_FLOAT, STM32
from edmctl.study.folder import open_folder
from edmctl.study.results import RunState
from tests.cli.commands import SHALLOW, Here
from tests.needs import EMULATOR
from tests.study.studies import FULL, HEAD, RESPONSES, outcome, written

JOB = ("machine", *SHALLOW, "--seed", "1", "--json")

TWO_LEVELS = """
[[factors]]
key = "servo.reference"
levels = [0.7, 0.8]
"""


def test_build_says_what_it_used_and_where_the_library_is(here: Here) -> None:
    said = here("firmware", "build", "--real", "double", "--json")
    (made,) = said.document["result"]["builds"]
    assert (said.exit_code, made["real"]) == (0, "double")
    assert Path(made["path"]).is_file()
    assert made["compiler"]


def test_build_refuses_another_arithmetic(here: Here) -> None:
    said = here("firmware", "build", "--real", "half", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (2, "E2048")


def _series(here: Here, controller: str) -> object:
    """One run of a series under a controller."""
    said = here("simulate", *SHALLOW, "--runs", "1", "--seed", "1", "--controller", controller, "--json")
    assert said.exit_code == 0, said.err
    (case,) = said.document["result"]["cases"]
    assert case["overrides"][-1] == f"sim.controller={controller}"
    return case["runs"]


@pytest.mark.expensive("compiles the library")
def test_runs_of_a_series_come_out_the_same_in_the_same_arithmetic(here: Here) -> None:
    rows = [_series(here, name) for name in (FIRMWARE, FIRMWARE, FIRMWARE_FLOAT)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


@EMULATOR
@pytest.mark.slow
def test_runs_of_a_series_go_under_the_image_of_a_board(here: Here) -> None:
    assert _series(here, STM32)


def test_a_study_keeps_what_drives_its_machines(here: Here, tmp_path: Path) -> None:
    text, tables = HEAD + TWO_LEVELS + FULL + RESPONSES, {}
    for controller in (FIRMWARE, FIRMWARE_FLOAT):
        file = written(tmp_path, text.replace("set = [", f"set = [\n\"sim.controller='{controller}'\","))
        out = tmp_path / controller
        made = here("study", "run", str(file), "-q", "--workers", "1", "--out", str(out))
        assert made.exit_code == 0, made.err
        state = open_folder(out).read()
        assert {one.state for one in state.runs} == {RunState.DONE}
        tables[controller] = outcome(state)
    assert all(a != b for a, b in zip(tables[FIRMWARE], tables[FIRMWARE_FLOAT], strict=True))


@pytest.mark.parametrize(
    "command",
    [
        JOB,
        ("simulate", *SHALLOW, "--json"),
        ("simulate", "serve", "--for", "0.1", "--json"),
        ("simulate", "serve", *SHALLOW, "--for", "0.1", "--json"),
        ("calibrate", "--json"),
    ],
    ids=["machine", "simulate", "serve", "serve a job", "calibrate"],
)
def test_another_controller_is_refused(command: tuple[str, ...], here: Here) -> None:
    said = here(*command, "--controller", "wood")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (2, "E2049")
    assert "no controller wood" in error["message"]
    assert all(name in error["message"] for name in CONTROLLERS)
