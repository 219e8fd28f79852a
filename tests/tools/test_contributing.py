"""The worked examples of CONTRIBUTING.md fit the sources, and do what is said of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
KEY, FAULT, FIELD = re.findall(
    r"^```diff\n(.*?)^```$", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.S | re.M
)
COPIED = ("edmctl", "firmware", "profiles", "studies", "tests", "tools", "docs")


def apply(tree: Path, diff: str) -> None:
    subprocess.run(["git", "apply", "-"], input=diff, encoding="utf-8", cwd=tree, check=True)


@pytest.mark.needs("git")
@pytest.mark.parametrize("diff", [KEY, FAULT, FIELD])
def test_an_example_fits_the_sources(diff: str, tmp_path: Path) -> None:
    for name in re.findall(r"^\+\+\+ b/(.+)$", diff, re.M):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tmp_path / name)
    apply(tmp_path, diff)


@pytest.mark.slow
@pytest.mark.needs("git", "ruff")
def test_the_examples_do_what_is_said(tmp_path: Path) -> None:
    for name in COPIED:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copyfile(ROOT / "pyproject.toml", tmp_path / "pyproject.toml")
    for diff in (KEY, FAULT, FIELD):
        apply(tmp_path, diff)

    def run(*words: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        command = [sys.executable, "-m", *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr + done.stdout
        return done.stdout

    run("tools.generate")
    run("pytest", "-q", "-m", "", "tests/faults", "-k", "SENSOR_STUCK")
    options = ("--set", "target.depth_um=10", "--seed", "1", "--json", "--quiet")
    job = ("edmctl", "machine", "--profile", "cu270", *options)
    plain, resting = (json.loads(run(*job, "--set", f"measure.clear_s={s}"))["result"] for s in (0, 5))
    assert resting["measuring_time_s"] > plain["measuring_time_s"] + 15.0
    (hole,) = plain["sites"]
    assert hole["mean_power_w"] == pytest.approx(hole["energy_j"] / hole["machining_time_s"], rel=1e-5)
    assert "clear_s" in (tmp_path / "docs/profile.md").read_text(encoding="utf-8")
    assert "SENSOR_STUCK" in (tmp_path / "docs/faults.md").read_text(encoding="utf-8")
    assert "mean_power" in (tmp_path / "docs/run-file.md").read_text(encoding="utf-8")
