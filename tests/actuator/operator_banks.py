"""Outputs of the operators in C on seeded banks of plays, for golden digests."""

import hashlib
from collections.abc import Iterator

import numpy as np

from edmctl.actuator.fitting import Design, features_of
from edmctl.actuator.inverse import Inverse
from edmctl.actuator.model import ActuatorState
from edmctl.actuator.paper_model import ElectromechanicalModel, MaxwellModel
from edmctl.actuator.record import Record
from edmctl.array_types import Array

SAMPLES = 200


def bank_of(rng: np.random.Generator) -> tuple[Design, Array]:
    """Return a bank without weights, and weights: up to 12 plays and 3 rounded ones, creep, a lag."""
    plays, pieces, rounded, lags = (int(rng.integers(*ends)) for ends in ((1, 13), (1, 6), (0, 4), (1, 8)))
    thresholds_v = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 6.0, plays - 1))])
    design = Design(
        thresholds_v=thresholds_v,
        knots_v=np.linspace(thresholds_v, 150.0 - thresholds_v, pieces + 1, axis=1),
        creep_plays=rng.integers(0, plays + rounded, rng.integers(0, 4)),
        time_constants_s=np.sort(np.round(10.0 ** rng.uniform(-2.0, 3.0, lags), 6)),
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
    """Return a digest of every byte of all outputs."""
    content = hashlib.sha256()
    for values in outputs(seed):
        content.update(np.ascontiguousarray(values).tobytes())
    return content.hexdigest()
