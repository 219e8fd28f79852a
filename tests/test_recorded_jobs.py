"""Jobs give the recorded results, whatever is moved in the code."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.recorded_jobs import SEEDS, jobs, recorded


def _assert_same(now: object, before: object, where: str) -> None:
    if isinstance(now, float) and isinstance(before, float):
        assert math.isclose(now, before, rel_tol=1e-9, abs_tol=1e-12), where
    elif isinstance(now, dict) and isinstance(before, dict):
        assert now.keys() == before.keys(), where
        for key in now:
            _assert_same(now[key], before[key], f"{where}.{key}")
    elif isinstance(now, list) and isinstance(before, list) and len(now) == len(before):
        for at, (one, other) in enumerate(zip(now, before, strict=True)):
            _assert_same(one, other, f"{where}[{at}]")
    else:
        assert now == before, where


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*SEEDS, None])
def test_jobs_give_the_recorded_results(
    seed: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EDMCTL_HOME", "")  # restored afterwards; the jobs set it
    monkeypatch.setattr("sys.argv", ["edmctl"])
    before = recorded()
    for name, text in jobs(seed).items():
        code, _, document = text.partition("\n")
        code_before, _, document_before = before[name].partition("\n")
        assert code == code_before, name
        _assert_same(json.loads(document), json.loads(document_before), name)
