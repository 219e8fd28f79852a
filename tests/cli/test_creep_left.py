"""Creep that one command leaves for the next one: noted, taken away in between, and never guessed."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from edmctl.jobs.connected_machine import CreepNote, Now
from edmctl.jobs.plan import MachineAddress
from edmctl.process.rest_drift import CreepLeft
from edmctl.profile.folders import creep_path
from tests.cli.commands import Here

HOLE = ("machine", "--profile", "cu270", "--set", "target.depth_um=12", "--json", "--quiet")
JUMPS = ("jump-flush", "--profile", "cu270", "--count", "1", "--json", "--quiet")


def notes(home: Path) -> list[Path]:
    return sorted((home / "drift").glob("*.creep.json"))


@pytest.fixture
def home(here: Here) -> Path:
    """Where edmctl keeps what it knows of machines."""
    assert here is not None
    return Path(os.environ["EDMCTL_HOME"])


def test_a_job_on_a_bench_leaves_its_creep_and_the_next_one_knows_the_use_before(
    home: Path, here: Here
) -> None:
    assert here(*HOLE, "--port", "sim:b.h5", "--seed", "3").document["ok"]
    (note,) = notes(home)
    first = json.loads(note.read_text(encoding="utf-8"))
    assert first["unknown_s"] is None  # a new bench was never used before
    assert max(first["lags_um"]) > 1.0
    assert here(*HOLE, "--port", "sim:b.h5").document["ok"]
    second = json.loads(note.read_text(encoding="utf-8"))
    assert second["unknown_s"] is None
    assert second["bench_s"] > first["bench_s"]
    slowest = -1
    assert second["lags_um"][slowest] > first["lags_um"][slowest]  # both holes are in it


def test_without_a_note_the_actuator_may_have_been_used_just_now(home: Path, here: Here) -> None:
    assert here(*HOLE, "--port", "sim:b.h5", "--seed", "3").document["ok"]
    (note,) = notes(home)
    note.unlink()
    assert here(*HOLE, "--port", "sim:b.h5").document["ok"]
    found = json.loads(note.read_text(encoding="utf-8"))
    assert 10.0 < found["unknown_s"] < 3600.0


@pytest.mark.parametrize(
    "damage", ["{", '{"schema": "edmctl-creep/1"}', "[]", '{"schema": "edmctl-creep/2", "lags_um": []}']
)
def test_a_note_that_cannot_be_is_none(home: Path, here: Here, damage: str) -> None:
    assert here(*JUMPS, "--port", "sim:b.h5", "--seed", "3").document["ok"]
    (note,) = notes(home)
    note.write_text(damage, encoding="utf-8")
    assert here(*JUMPS, "--port", "sim:b.h5").document["ok"]
    assert json.loads(note.read_text(encoding="utf-8"))["unknown_s"] < 3600.0


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param({"unknown_s": 10**400}, id="a time that is no float"),
        pytest.param({"lags_um": [10**400] * 9}, id="lags that are no floats"),
        pytest.param({"bench_s": "soon"}, id="a time that is text"),
        pytest.param("[" * 100_000, id="deep"),
        pytest.param(None, id="a pipe"),
    ],
)
def test_a_note_that_was_tampered_with_is_none_and_keeps_nobody_waiting(
    tmp_path: Path, damage: dict[str, object] | str | None
) -> None:
    environ = {"EDMCTL_HOME": str(tmp_path)}
    bench = SimpleNamespace(
        seed=None, now=Now(200.0), machine=SimpleNamespace(identity=SimpleNamespace(serial="M"))
    )
    note = CreepNote(bench, MachineAddress("/dev/none"), environ)  # type: ignore[arg-type]
    note.leave(CreepLeft.none())
    path = creep_path("M", environ)
    kept = note.read()
    assert kept is not None
    assert kept.unknown_s == math.inf
    if isinstance(damage, dict):
        path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | damage), encoding="utf-8")
    elif damage:
        path.write_text(damage, encoding="utf-8")
    else:
        path.unlink()
        os.mkfifo(path)
    found = note.read()
    assert found is not None
    assert found.unknown_s == 0.0


def test_a_fresh_machine_leaves_no_note(home: Path, here: Here) -> None:
    assert here(*JUMPS, "--seed", "3").document["ok"]
    assert not notes(home)


def test_a_copy_of_a_bench_is_another_machine(home: Path, here: Here) -> None:
    assert here(*JUMPS, "--port", "sim:b.h5", "--seed", "3").document["ok"]
    Path("b.h5").rename("c.h5")
    assert here(*JUMPS, "--port", "sim:c.h5").document["ok"]
    (note,) = notes(home)
    assert json.loads(note.read_text(encoding="utf-8"))["unknown_s"] < 3600.0


def test_a_job_after_a_use_that_nobody_followed_says_so(home: Path, here: Here) -> None:
    drift = ("measure-drift", "--profile", "cu270", "--duration", "660", "--quiet")
    assert here(*drift, "--port", "sim:b.h5", "--seed", "3").exit_code == 0
    assert "W8108" not in here(*HOLE, "--port", "sim:b.h5").err
    (note,) = notes(home)
    note.unlink()
    said = here("machine", "--profile", "cu270", "--set", "target.depth_um=12", "--port", "sim:b.h5")
    assert "W8108" in said.err
