"""A job on a line without frames is the job on a line with them."""

from __future__ import annotations

import numpy as np

from tests.procedures.conftest import Shop


def test_a_job_without_frames_is_the_job_with_them() -> None:
    framed, direct = Shop(direct=False), Shop(direct=True)
    results = framed.run_job(), direct.run_job()
    assert results[0].sites == results[1].sites
    assert results[0].time_s == results[1].time_s
    for name in ("time_s", "displacement_um", "model_um", "gap_v", "state"):
        ours, theirs = (
            np.concatenate([getattr(row, name) for row in s.seen.servo]) for s in (framed, direct)
        )
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
