"""What `measure-drift` tells people."""

from __future__ import annotations

import math

from edmctl.cli.render.procedure_tables import render_drift
from edmctl.results.measurements import DriftResult

FOUND = DriftResult(
    rest_um_per_s=0.00062,
    rest_u_um_per_s=0.00016,
    touch_um_per_s=0.0038,
    touch_u_um_per_s=0.0001,
    apart_um_per_s=0.0032,
    apart_u_um_per_s=0.0002,
    share=math.nan,
    share_u=math.nan,
    share_used=1.0,
    share_used_u=0.58,
    creep_um=2.4,
    creep_u_um=0.1,
    rests=24,
    touches=11,
    outliers=0,
    misfit=1.0,
    rest_rms_um=0.04,
    touch_rms_um=0.05,
    hold_um=250.0,
    hold_s=300.0,
    time_s=950.0,
)


def test_rests_that_have_only_walked_tell_no_share_and_that_is_said() -> None:
    text = " ".join(render_drift(FOUND, None, "drift.toml", "jobs go by it", replaced=False).split())
    assert "share that a touch sees –" in text
    assert "The rests have not drifted by more than their random walk: no share can be told." in text
    assert "Jobs take 100 % of the drift of their rests off wear, Z2 and Z3." in text


def test_the_truth_is_beside_what_was_measured() -> None:
    truth = {"sensor_um_per_s": 0.0009, "machine_um_per_s": 0.003}
    lines = render_drift(FOUND, truth, "drift.toml", "jobs go by it", replaced=False).splitlines()
    assert "drift of the touches 3.80 ± 0.20 nm/s 3.90 nm/s" in [" ".join(line.split()) for line in lines]
    assert all(len(line) <= 80 for line in lines[:-1])
