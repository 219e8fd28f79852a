"""What `measure-wear` prints."""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.cli.render.procedure_tables import render_wear
from edmctl.labels import Basis
from edmctl.results.measurements import UncertaintyPart, WearResult

FOUND = WearResult(
    z1_um=50.0,
    z2_um=87.0,
    z3_um=57.0,
    z3_before_um=57.0,
    z3_after_um=57.0,
    drift_um=0.0,
    drift_correction_um=0.0,
    touches=3,
    sd_um=(0.05, 0.05, 0.05, 0.05),
    wear_um=7.0,
    wear_u95_um=0.5,
    depth_um=30.0,
    depth_u95_um=0.4,
    feed_um=37.0,
    feed_u95_um=0.6,
    wear_model_um=7.1,
    wear_model_u95_um=1.0,
    depth_model_um=29.9,
    depth_model_u95_um=1.0,
    feed_model_um=37.0,
    feed_model_u95_um=1.4,
    budget=(UncertaintyPart("gain of the sensor", 0.02, 0.09, 0.11),),
    depth_basis=Basis.TOUCHED,
    wear_basis=Basis.TOUCHED,
    time_s=100.0,
)
NAN = math.nan
NO_HOLE = replace(
    FOUND,
    z2_um=NAN,
    depth_um=NAN,
    depth_u95_um=NAN,
    feed_um=NAN,
    feed_u95_um=NAN,
    depth_basis=None,
    budget=(UncertaintyPart("gain of the sensor", 0.02, NAN, NAN),),
)


def test_what_was_not_measured_is_not_in_the_table() -> None:
    text = render_wear("Cu 270 µm", NO_HOLE, 6.9, 7.0, None)
    assert "depth  " not in text
    assert "feed  " not in text
    assert "Z2" not in text
    assert "No depth: the tool's last job left no measured bottom." in text
    assert "0.02 µm" in text


def test_the_depth_of_a_suspect_touch_is_estimated() -> None:
    rows = render_wear("hole", replace(FOUND, depth_basis=Basis.ESTIMATED), 6.9, 7.0, None).splitlines()
    assert "measured" not in rows[0]
    assert "~30.00 ± 0.40 µm" in rows[1]
    assert "  7.00 ± 0.50 µm" in rows[2]
    assert "~37.00 ± 0.60 µm" in rows[3]


def test_a_drift_that_was_taken_off_is_stated() -> None:
    assert "drift of 2.70 µm since" in render_wear(
        "hole", replace(FOUND, drift_correction_um=2.7), 6.9, 7.0, None
    )
