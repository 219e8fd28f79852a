"""The script of the documentation: separate processes on one bench, whose numbers add up."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.cli.commands import ROOT, in_a_shell
from tests.cli.test_documents import newcomer

pytestmark = pytest.mark.slow

SCRIPT = ROOT / "docs" / "batch.sh"
ROUNDING_UM = 0.0021
"""The JSON object keeps three decimals."""


def test_the_numbers_of_the_script_add_up(tmp_path: Path) -> None:
    folder, env = newcomer(tmp_path)
    done = in_a_shell("sh", str(SCRIPT), cwd=folder, env=env, timeout_s=300.0)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    lines = (folder / "results.jsonl").read_text(encoding="utf-8").splitlines()
    first, last = (site for line in lines for site in json.loads(line)["result"]["sites"])
    document = json.loads(done.stdout.splitlines()[-1])
    measured = document["result"]
    assert (document["command"], first["name"], last["name"]) == ("measure-wear", "cu150-cu", "cu270-cu")
    for found in (first, last, measured):
        assert abs(found["feed_um"] - found["depth_um"] - found["wear_um"]) <= ROUNDING_UM
        # Twice the 95 % half-width: another machine every time, and a test must not fail once in twenty runs.
        for key in ("depth", "wear"):
            error_um = abs(found[f"{key}_um"] - found["truth"][f"{key}_um"])
            assert error_um <= 2.0 * found[f"{key}_u95_um"], (key, found)
    assert abs(measured["ledger"]["wear_um"] - last["wear_um"]) <= ROUNDING_UM
    for key in ("depth", "wear"):
        bound_um = math.hypot(measured[f"{key}_u95_um"], last[f"{key}_u95_um"])
        assert abs(measured[f"{key}_um"] - last[f"{key}_um"]) <= bound_um
    assert math.dist((first["x_um"], first["y_um"]), (last["x_um"], last["y_um"])) > 83.0 + 143.0
    ledger = (folder / "runs" / "ledger.jsonl").read_text(encoding="utf-8")
    assert len({json.loads(line)["serial"] for line in ledger.splitlines()}) == 1
