"""The script of the documentation: separate processes on one bench, whose numbers add up."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tests.cli.commands import ROOT, environment, in_a_shell
from tests.cli.test_documents import newcomer
from tests.cli.warm_process import warm_process

pytestmark = pytest.mark.slow

SCRIPT = ROOT / "docs" / "batch.sh"
ROUNDING_UM = 0.0021
"""The JSON object keeps three decimals."""


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder where the script has run, and what it wrote to stdout."""
    with warm_process(environment()) as warm:
        folder, env = newcomer(tmp_path_factory.mktemp("batch"), warm)
        done = in_a_shell("sh", str(SCRIPT), cwd=folder, env=env, timeout_s=300.0)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return folder, done.stdout


@pytest.fixture(scope="module")
def sites(batch: tuple[Path, str]) -> list[dict[str, Any]]:
    """The holes of the script."""
    lines = (batch[0] / "results.jsonl").read_text(encoding="utf-8").splitlines()
    return [site for line in lines for site in json.loads(line)["result"]["sites"]]


@pytest.fixture(scope="module")
def measured(batch: tuple[Path, str]) -> dict[str, Any]:
    """What the last command of the script found."""
    document = json.loads(batch[1].splitlines()[-1])
    assert document["command"] == "measure-wear"
    result: dict[str, Any] = document["result"]
    return result


def test_every_feed_is_depth_and_wear(sites: list[dict[str, Any]], measured: dict[str, Any]) -> None:
    assert [site["name"] for site in sites] == ["cu150-cu", "cu270-cu"]
    for found in (*sites, measured):
        assert abs(found["feed_um"] - found["depth_um"] - found["wear_um"]) <= ROUNDING_UM


def test_the_last_measurement_is_the_wear_of_the_tools_jobs(
    sites: list[dict[str, Any]], measured: dict[str, Any]
) -> None:
    last = sites[-1]
    bound_um = math.hypot(measured["wear_u95_um"], last["wear_u95_um"])
    assert abs(measured["wear_um"] - last["wear_um"]) <= bound_um
    assert abs(measured["ledger"]["wear_um"] - last["wear_um"]) <= ROUNDING_UM
    assert abs(measured["depth_um"] - last["depth_um"]) <= math.hypot(
        measured["depth_u95_um"], last["depth_u95_um"]
    )


def test_all_of_it_is_true_within_what_it_says(sites: list[dict[str, Any]], measured: dict[str, Any]) -> None:
    # Twice the 95 % half-width: another machine every time, and a test must not fail once in twenty runs.
    for found in (*sites, measured):
        for key in ("depth", "wear"):
            error_um = abs(found[f"{key}_um"] - found["truth"][f"{key}_um"])
            assert error_um <= 2.0 * found[f"{key}_u95_um"], (key, found)


def test_the_holes_lie_beside_each_other(batch: tuple[Path, str], sites: list[dict[str, Any]]) -> None:
    first, second = sites
    assert math.dist((first["x_um"], first["y_um"]), (second["x_um"], second["y_um"])) > 83.0 + 143.0
    ledger = (batch[0] / "runs" / "ledger.jsonl").read_text(encoding="utf-8")
    assert len({json.loads(line)["serial"] for line in ledger.splitlines()}) == 1
