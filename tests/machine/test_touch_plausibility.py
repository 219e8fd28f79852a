"""Touches against the samples of their dwell."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest

from edmctl.errors import EdmError
from edmctl.machine import inbox
from edmctl.machine.decode import telemetry_block
from edmctl.machine.interface import Axis, TelemetryFlag, TouchRequest
from edmctl.machine.plausibility import contradicts_samples
from edmctl.results.telemetry import TelemetryBlock
from tests.machine.conftest import Rig
from tests.tiers import tiers


@pytest.mark.parametrize("samples", tiers(10, slow=(3, 30)))
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


@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize("dwell_s", [0.1, 0.3, 0.305])
def test_a_touch_whose_samples_show_no_contact_is_refused(
    direct: bool, dwell_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_contact(*arguments: Any) -> TelemetryBlock:
        block = telemetry_block(*arguments)
        block.flags = block.flags & ~np.uint8(TelemetryFlag.CONTACT)
        return block

    r = Rig(direct=direct).ready()
    r.machine.move_stage(Axis.X, 0.0, 5000.0)
    request = TouchRequest(20.0, 40.0, 2.0, 80.0, 5.0, dwell_s, 1)
    assert len(r.machine.touch(request)) == 1
    r.machine.ramp(0.0, 50.0)
    monkeypatch.setattr(inbox, "telemetry_block", without_contact)
    with pytest.raises(EdmError, match="no sample in contact"):
        r.machine.touch(request)
