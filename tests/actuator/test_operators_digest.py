"""Outputs of the operators in C on seeded banks, against digests.

The digests were recorded from the implementation with numba, which C replaced; both gave the same bytes then. They
are of numbers rounded to 1e-8 of the largest, so that another C library's `exp` does not change them.
"""

import hashlib
from collections.abc import Iterator

import numpy as np
import pytest

from edmctl.actuator.design import Design, features_of
from edmctl.actuator.electromechanical import ElectromechanicalModel
from edmctl.actuator.inverse import Inverse
from edmctl.actuator.maxwell import MaxwellModel
from edmctl.actuator.model import ActuatorState
from edmctl.actuator.record import Record
from tests.actuator.models import Array

SAMPLES = 200
BANKS = (
    "475ce3e07919ca09",
    "0e3408db98ca75b2",
    "c620773127c84c45",
    "eb457348720410fe",
    "146c6d6844033409",
    "6fe4d0b4e11bcbea",
    "1980fbaa8a85621d",
    "ef44215d00e495d1",
    "e6579026db41e359",
    "a70bdedcfac5e1a7",
    "4b3e0bf6c18bd865",
    "a3aff8d201fa5874",
    "f3de34cb02c1fd41",
    "362d7482a70b68d1",
    "a6088a28484d3eca",
    "9e093ae4725b43c3",
    "5855d9e14abb2aa2",
    "8eff4a917b50a423",
    "3a0bcf1beb537b1c",
    "d159dcc03f78ebfa",
)


def bank_of(rng: np.random.Generator) -> tuple[Design, Array]:
    """Return a bank without weights, and weights: up to 12 plays and 3 rounded ones, creep, a lag."""
    plays, pieces, rounded, lags = (int(rng.integers(*ends)) for ends in ((1, 13), (1, 6), (0, 4), (1, 8)))
    thresholds_v = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 6.0, plays - 1))])
    design = Design(
        thresholds_v=thresholds_v,
        knots_v=np.linspace(thresholds_v, 150.0 - thresholds_v, pieces + 1, axis=1),
        creep_plays=rng.integers(0, plays + rounded, rng.integers(0, 4)),
        time_constants_s=np.sort(10.0 ** rng.uniform(-2.0, 3.0, lags)),
        column_of=np.minimum(np.arange(lags), lags // 2),
        low_v=0.0,
        high_v=150.0,
        rounded=np.column_stack(
            [
                rng.uniform(5.0, 60.0, (rounded, 2)),
                rng.choice([0.0, 0.4, 1.0], rounded),
                rng.uniform(0, 2, rounded),
            ]
        ),
        lag_s=float(rng.choice([0.0, 0.002, 0.05])),
    )
    weights = rng.uniform(0.0, 0.05, design.features)
    weights[design.first_play] += 0.5
    return design, weights


def outputs(seed: int) -> Iterator[Array]:
    """Yield what every operator makes of a record; the inverse has to leave the range for part of it."""
    rng = np.random.default_rng(seed)
    design, weights = bank_of(rng)
    t_s = np.cumsum(rng.exponential(0.02, SAMPLES) if seed % 2 else np.full(SAMPLES, 0.01))
    u_v = np.clip(75.0 + np.cumsum(rng.normal(0.0, 6.0, SAMPLES)), 0.0, 150.0)
    model = design.model(weights, zero_um=-2.0, delay_s=0.0)
    state = ActuatorState.after_jump(model, 30.0, float(u_v[0]))
    inverse = Inverse(model, state)
    y_um = model.advance(state, t_s, u_v)
    yield y_um
    yield from (state.plays_v, state.stops_v, state.lags_v)
    found_v, beyond = inverse.solve(t_s, 1.2 * y_um)
    yield found_v
    yield beyond.astype(np.float64)
    yield features_of(design, Record(t_s, u_v, y_um, 30.0))
    maxwell = MaxwellModel.from_plays(design.thresholds_v, np.full(len(design.thresholds_v), 0.1))
    slipping = maxwell.conditioned(0.0, 150.0)
    yield maxwell.displacement(u_v, slipping)
    yield maxwell.voltage(y_um, slipping)
    electromechanical = ElectromechanicalModel.from_maxwell(maxwell)
    yield from electromechanical.simulate(u_v, 2e-5, rng.uniform(0.0, 5.0, SAMPLES))


def digest_of(seed: int) -> str:
    """Return a digest of all outputs."""
    content = hashlib.sha256()
    for values in outputs(seed):
        largest = np.abs(values).max(initial=0.0)
        content.update((np.round(values / (largest or 1.0), 8) + 0.0).tobytes())
    return content.hexdigest()[:16]


@pytest.mark.parametrize("seed", range(len(BANKS)))
def test_outputs_are_those_that_were_recorded(seed: int) -> None:
    assert digest_of(seed) == BANKS[seed]
