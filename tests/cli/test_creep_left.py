"""Creep that one command leaves for the next one: noted, taken away in between, and never guessed."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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
    def left() -> dict[str, Any]:
        found: dict[str, Any] = json.loads(note.read_text(encoding="utf-8"))
        return found

    assert here(*JUMPS, "--seed", "3").document["ok"]
    assert not notes(home)  # of a fresh machine
    assert here(*HOLE, "--port", "sim:b.h5", "--seed", "3").document["ok"]
    (note,) = notes(home)
    first = left()
    assert first["unknown_s"] is None  # a new bench was never used before
    assert max(first["lags_um"]) > 1.0
    assert here(*HOLE, "--port", "sim:b.h5").document["ok"]
    second = left()
    assert second["unknown_s"] is None
    assert second["bench_s"] > first["bench_s"]
    slowest = -1
    assert second["lags_um"][slowest] > first["lags_um"][slowest]  # both holes are in it
    note.unlink()  # without a note the actuator may have been used just now
    assert here(*JUMPS, "--port", "sim:b.h5").document["ok"]
    assert 10.0 < left()["unknown_s"] < 3600.0
    Path("b.h5").rename("c.h5")  # a copy of a bench is another machine
    assert here(*JUMPS, "--port", "sim:c.h5").document["ok"]
    assert left()["unknown_s"] < 3600.0


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param({"unknown_s": 10**400}, id="a time that is no float"),
        pytest.param({"lags_um": [10**400] * 9}, id="lags that are no floats"),
        pytest.param({"bench_s": "soon"}, id="a time that is text"),
        pytest.param({"schema": "edmctl-creep/2"}, id="another schema"),
        pytest.param({"lags_um": []}, id="no lags"),
        pytest.param("[]", id="a list"),
        pytest.param("{", id="no JSON"),
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


@pytest.mark.slow
def test_a_job_after_a_use_that_nobody_followed_says_so(home: Path, here: Here) -> None:
    Path("quick.toml").write_text("[drift]\nhold_s = 30.0\ninterval_s = 25.0\n", encoding="utf-8")
    drift = ("measure-drift", "--profile", "cu270", "--setup", "quick.toml", "--duration", "300", "--quiet")
    assert here(*drift, "--port", "sim:b.h5", "--seed", "3").exit_code == 0
    assert "W8108" not in here(*HOLE, "--port", "sim:b.h5").err
    (note,) = notes(home)
    note.unlink()
    said = here("machine", "--profile", "cu270", "--set", "target.depth_um=12", "--port", "sim:b.h5")
    assert "W8108" in said.err
