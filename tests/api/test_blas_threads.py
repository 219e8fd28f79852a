"""Linear algebra in a program that imports edmctl: one BLAS thread, as in the command."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from edmctl.start_up import VARIABLES
from tests.tiers import tiers

ROOT = Path(__file__).parents[2]

START = """
import functools, threading
import MODULE
import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

# Three also on a computer with one core. A thread that has ended leaves the limit to others.
setter = threading.Thread(target=threadpool_limits, args=(3, "blas"))
setter.start()
setter.join()
seen = {}

def threads():
    return {library["num_threads"] for library in threadpool_info()}

def watched(module, name):
    original = getattr(module, name)

    @functools.wraps(original)
    def call(*arguments, **options):
        calls = seen.setdefault(name, [])
        if len(calls) < 20:
            calls.append(max(threads()))
        return original(*arguments, **options)

    setattr(module, name, call)

"""
SHORT = """
from edmctl.start_up import one_blas_thread
watched(np.linalg, "solve")
with one_blas_thread(), one_blas_thread():
    np.linalg.solve(np.eye(2), np.ones(2))
print((seen, threads()))
"""
PROGRAM = """
for name in ("qr", "solve", "lstsq", "inv", "cholesky", "matrix_rank"):
    watched(np.linalg, name)
watched(scipy.linalg, "cholesky")

from edmctl.actuator import Record, identify
from edmctl.study.statistics.surrogates import fit_process
from edmctl.study.statistics.response_analysis import Runs, analyse
from edmctl.study.statistics.linear_model import Settings
from tests.process.test_rest_drift import measured

t_s = np.arange(0.0, 20.0, 0.02)
u_v = np.interp(t_s, [0, 2, 4, 6, 8, 12, 13, 14, 16, 20], [0, 150, 0, 150, 0, 0, 110, 30, 150, 0])
y_um = 3.0 * u_v + 0.01 * np.sin(40.0 * t_s)
identify([Record(t_s, u_v, y_um)], resamples=5)
points = np.random.default_rng(1).random((12, 2))
process = fit_process(points, points.sum(axis=1), blocks=[0, 1] * 6)
process.believing(points[:2]).predict(points)
measured(0.0025, 0.0)
runs = Runs(Settings({"x": np.arange(8.0)}, {}, {}), {}, range(8), [0] * 8)
analyse("depth", runs, [1.0, 3.0, 2.0, 5.0, 4.0, 6.0, 8.0, 7.0], [(), (("x", 1),)], "smaller")
alone = dict(seen)
for name in seen:
    seen[name] = [1] * 20
both = [threading.Thread(target=fit_process, args=(points, points[:, 0])) for _ in range(2)]
for fit in both:
    fit.start()
for fit in both:
    fit.join()
print((alone, threads()))
"""


@pytest.mark.parametrize(("module", "program"), tiers(("numpy", SHORT), slow=(("scipy.linalg", PROGRAM),)))
def test_linear_algebra_runs_in_one_thread_and_the_limit_ends(module: str, program: str) -> None:
    bare = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    run = subprocess.run(
        [sys.executable, "-c", START.replace("MODULE", module) + program],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=bare,
    )
    assert run.returncode == 0, run.stderr
    seen, after = ast.literal_eval(run.stdout)
    assert set(seen) >= ({"qr", "solve", "lstsq", "inv", "cholesky"} if program is PROGRAM else {"solve"})
    assert all(set(threads) == {1} for threads in seen.values())
    assert after == {3}
