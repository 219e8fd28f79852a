"""One unit of the machine as its seed draws it: its actuator, and its random numbers.

The actuator is deliberately richer than any estimator of this project: forty play operators on thresholds of no
one's grid, a tanh envelope on their sum, twelve creep time constants, an amplifier's lag and an output-side mode
(class of Kuhnen's modified Prandtl-Ishlinskii operator with linear creep). It is scaled to the 445 µm at 150 V of
Muralidhara et al. 2009, §2.1. Functions of the library draw it, with the same bytes on every computer.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.simulator.plant_records import CREEP_TERMS, PLAYS, TABLE, TICK_S, PlantState, Unit

BLOCK = 32768
"""Random numbers that are drawn at once."""

PLAY_SPAN_V = 62.0
REVERSIBLE_SHARE = 0.48
PLAY_DENSITY_V = 26.0  # e-folding of the weights over the threshold
GAIN_UM_PER_V = 2.70  # sum of the weights: 445 µm peak to peak from 0 to 150 V in 100 s
CREEP_FIRST_S = 0.0063
CREEP_RATIO = 3.17
CREEP_PER_DECADE = 0.030
ENVELOPE_UM, ENVELOPE_CENTRE_UM, ENVELOPE_WIDTH_UM = 22.0, 190.0, 120.0
AMPLIFIER_LAG_S = 0.002
MODE_HZ, MODE_DAMPING = 320.0, 0.04  # loaded output-side resonance [assumed]


def draw_actuator(unit: Unit, build: np.random.Generator) -> None:
    """Draw this unit's plays and creep."""
    c = library()
    thresholds = PLAY_SPAN_V * np.array([c.pow((k + 0.37) / PLAYS, 1.35) for k in range(PLAYS)])
    thresholds *= 1.0 + 0.03 * build.standard_normal(PLAYS)
    weights = np.array([c.exp(-v / PLAY_DENSITY_V) for v in thresholds])
    weights *= 1.0 + 0.1 * build.standard_normal(PLAYS)
    weights *= (1.0 - REVERSIBLE_SHARE) / weights.sum()
    thresholds.sort()
    thresholds[0] = 0.013
    weights[0] += REVERSIBLE_SHARE
    weights *= GAIN_UM_PER_V * (1.0 + 0.01 * build.standard_normal())
    taus_s = [CREEP_FIRST_S * c.pow(CREEP_RATIO, k) for k in range(CREEP_TERMS)]
    decades = c.log(CREEP_RATIO) / c.log(10.0)
    creep_shares = CREEP_PER_DECADE * decades * (1.0 + 0.1 * build.standard_normal(CREEP_TERMS))
    unit.array("play_threshold_v")[:] = thresholds
    unit.array("play_um_per_v")[:] = weights
    unit.array("creep_decay")[:] = [c.exp(-TICK_S / tau_s) for tau_s in taus_s]
    unit.array("creep_share")[:] = creep_shares


def set_actuator(unit: Unit, state: PlantState) -> None:
    """Set its constants, and leave it as after yesterday's work: cycled over the full range, at 0 V, creep gone."""
    c = library()
    unit.amplifier_decay = c.exp(-TICK_S / AMPLIFIER_LAG_S)
    unit.envelope_um, unit.envelope_centre_um = ENVELOPE_UM, ENVELOPE_CENTRE_UM
    unit.envelope_steepness = 2.0 / ENVELOPE_WIDTH_UM
    omega, zeta = 2.0 * math.pi * MODE_HZ, MODE_DAMPING
    damped = omega * math.sqrt(1.0 - zeta**2)
    decay = c.exp(-zeta * omega * TICK_S)
    cos, sin = c.cos(damped * TICK_S), c.sin(damped * TICK_S)
    unit.mode_a11 = decay * (cos + zeta * omega / damped * sin)
    unit.mode_a12 = decay * sin / damped
    unit.mode_a21 = -decay * omega**2 / damped * sin
    unit.mode_a22 = decay * (cos - zeta * omega / damped * sin)
    thresholds, plays = unit.array("play_threshold_v"), state.array("play_v")
    for u in (150.0, 0.0, 150.0, 0.0):
        np.clip(plays, u - thresholds, u + thresholds, out=plays)
    y = math.fsum(unit.array("play_um_per_v") * plays)
    state.play_sum_um = y
    y += ENVELOPE_UM * (1.0 - 2.0 / (c.exp((y - ENVELOPE_CENTRE_UM) * unit.envelope_steepness) + 1.0))  # tanh
    state.array("creep_um")[:] = y
    unit.actuator_zero_um = y * (1.0 + float(unit.array("creep_share").sum()))


class RandomBlocks:
    """Random numbers in blocks, one stream a quantity, so that results do not depend on where blocks end."""

    def __init__(self, seed: np.random.SeedSequence, scatter: float) -> None:
        streams = [np.random.Generator(np.random.SFC64(s)) for s in seed.spawn(4)]
        self._decide, self._shape, self._delay, self._noise = streams
        self.pulse = np.empty((3, BLOCK))
        self.noise = np.empty(BLOCK)
        self.tables = _tables(scatter).copy()
        self._fill_pulse(0)
        self._fill_noise(0)

    def _fill_pulse(self, start: int) -> None:
        self._decide.random(out=self.pulse[0, start:])
        self._shape.random(out=self.pulse[1, start:])
        self._delay.standard_exponential(out=self.pulse[2, start:])

    def _fill_noise(self, start: int) -> None:
        self._noise.standard_normal(out=self.noise[start:])

    def provide(self, state: PlantState, pulses: int, noises: int) -> None:
        """Make sure that so many numbers lie ahead of the places up to which they are used."""
        at = state.random_at
        if at + pulses > BLOCK:
            rest = BLOCK - at
            self.pulse[:, :rest] = self.pulse[:, at:].copy()
            self._fill_pulse(rest)
            state.random_at = 0
        at = state.noise_at
        if at + noises > BLOCK:
            rest = BLOCK - at
            self.noise[:rest] = self.noise[at:].copy()
            self._fill_noise(rest)
            state.noise_at = 0


@lru_cache(16)
def _tables(scatter: float) -> Array:
    """Equally likely values of |N(0, 1)| and of a lognormal of mean one: the middles of TABLE equal steps.

    Quantiles lack the digits in which C libraries differ; none is near a tie.
    """
    steps, quantile, exp = (np.arange(TABLE) + 0.5) / TABLE, NormalDist().inv_cdf, library().exp
    half = [round(quantile(0.5 + 0.5 * p), 10) for p in steps]
    volume = np.array([exp(scatter * round(quantile(p), 10)) for p in steps])
    return np.stack([half, volume / volume.mean()])
