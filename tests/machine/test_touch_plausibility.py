"""Touches against the samples of their dwell."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from edmctl.machine.plausibility import contradicts_samples


@pytest.mark.parametrize("samples", [3, 10, 30])
def test_touches_must_be_what_the_samples_of_their_dwell_say(samples: int) -> None:
    random, doubted = Random(2), 0
    for _ in range(2_000):
        seen_um = np.array([random.gauss(50.0, 0.1) for _ in range(samples)])
        dwell_um = [*seen_um, *(random.gauss(50.0, 0.1) for _ in range(300 - samples))]
        doubted += contradicts_samples(float(np.mean(dwell_um)), seen_um)
    assert doubted == 0
    for lie_um in (62.5, 51.0, 2_147_483.0):
        assert contradicts_samples(lie_um, seen_um)
    assert not contradicts_samples(62.5, np.array([50.0, 50.1]))
