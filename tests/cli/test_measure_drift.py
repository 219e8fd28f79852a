"""measure-drift by itself, and the job that goes by what it tells."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import pytest

from edmctl.profile.drift_file import DriftFile
from tests.cli.commands import CU270, HURRIED, SHALLOW, Here

QUICK = "[drift]\nhold_s = 30.0\ninterval_s = 25.0\n"
SEED = ("--seed", "2")


@pytest.fixture
def setup(tmp_path: Path) -> tuple[str, str]:
    """A setup that measures drift in three minutes."""
    path = tmp_path / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return "--setup", str(path)


def test_a_dry_run_tells_what_it_takes(here: Here) -> None:
    said = here("measure-drift", "--profile", CU270, "--dry-run", "--json")
    forecast = said.document["result"]["forecast"]
    assert (forecast["touches"], forecast["hold_s"], forecast["hold_um"]) == (11, 300.0, 250.0)
    assert 900.0 < forecast["time_s"] < 1100.0
    plan = " ".join(here("measure-drift", "--profile", CU270, "--dry-run").out.split())
    assert "touches each 11 a touch every 1 min 00 s" in plan


@pytest.mark.parametrize(
    ("arguments", "text", "exit_code", "code"),
    [
        pytest.param(("--duration", "400"), "", 2, "E2064", id="too short"),
        pytest.param(("--duration", "inf"), "", 2, "E2064", id="endless"),
        pytest.param(("--duration", "nan"), "", 2, "E2064", id="no number"),
        pytest.param(("--duration", "14401"), "", 2, "E2064", id="longer than the setup may say"),
        pytest.param((), "[sensor]\nfitted = false\n", 8, "E8034", id="no sensor"),
    ],
)
def test_what_cannot_be_measured_is_refused_with_a_remedy(
    here: Here, tmp_path: Path, arguments: tuple[str, ...], text: str, exit_code: int, code: str
) -> None:
    path = tmp_path / "setup.toml"
    path.write_text(text, encoding="utf-8")
    named = ("--setup", str(path), "--allow-model") if text else ()
    said = here("measure-drift", *arguments, *named, "--dry-run", "--json")
    assert said.exit_code == exit_code
    assert said.document["error"]["code"] == code
    assert said.document["error"]["hint"]


def test_a_fresh_machine_s_file_counts_where_it_is_named(
    here: Here, setup: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = ("--profile", CU270, *HURRIED, "--duration", "300")
    measured = here("measure-drift", *quick, *setup, *SEED, "--quiet")
    assert measured.exit_code == 0
    said = " ".join(measured.out.split())
    (file,) = re.findall(r"`EDMCTL_DRIFT=(\S+) edmctl machine --profile PROFILE --seed 2` goes by it", said)
    assert Path(file).parent.name == "fresh"
    assert DriftFile.load(Path(file)).made.serial == "SIM-2"
    monkeypatch.setenv("EDMCTL_DRIFT", file)
    document = here("machine", *SHALLOW, *SEED, "--json", "--quiet").document
    result = document["result"]
    assert file in result["drift_file"]
    with h5py.File(document["run_file"]) as kept:
        assert kept["/entry/machine/drift_toml"].asstr()[()] == Path(file).read_text(encoding="utf-8")
    (site,) = result["sites"]
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) < site["wear_u95_um"]
    assert [belief["seen"] for belief in result["beliefs"]][-1] == "cannot be seen"
