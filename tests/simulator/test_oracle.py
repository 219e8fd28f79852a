"""The compiled kernel and the same source run as plain Python give the same machine."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCRIPT = """
import hashlib
from random import Random
from edmctl.link import messages as m
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, open_bench
bench = open_bench(BenchConfig(offset_um=5.0), 4)
session = Session(bench.transport, Random(1))
frames = []
session.subscribe(m.Tlm, lambda t: frames.append(t.records))
session.subscribe(m.Pulses, lambda p: frames.append(p.records))
session.open()
crc = m.param_crc({})
session.request(m.CommitProfile(crc))
session.request(m.Arm(crc))
session.request(m.PulseEnable(1))
session.request(m.StageMove(m.Axis.X, 0, 50_000_000))
session.pump(0.3)
session.request(m.TlmStart(1000, 14, m.PulseLog.FULL))
session.request(m.Approach(5.0, 60.0, 10.8))
session.pump(0.4)
if bench.controller.state is m.State.ARMED:
    session.request(m.ServoStart(9.6, 500.0, 100.0))
else:
    session.request(m.ServoStop())
    session.request(m.ServoStart(9.6, 500.0, 100.0))
session.pump(0.8)
session.request(m.Jump(10.0, 2000.0, 0.02, 2.0))
session.pump(0.3)
session.request(m.ServoStop())
session.request(m.ScanStart(9.6, 8.0, 100.0))
session.request(m.PathMove(8.0, 6.0, 50.0, 7.5, 1))
session.pump(0.4)
x_um, y_um, depth_um = bench.truth_map()
assert depth_um.max() > 0.0 and bench.plant.reported[:2] == [8.0, 6.0]
frames.append(depth_um.tobytes())
assert len(b"".join(frames)) > 10_000
print(hashlib.sha256(b"".join(frames)).hexdigest())
"""


def digest(disable_jit: str) -> str:
    env = {**os.environ, "NUMBA_DISABLE_JIT": disable_jit}
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.mark.slow
def test_plain_python_is_the_oracle_of_the_compiled_kernel() -> None:
    assert digest("1") == digest("0")
