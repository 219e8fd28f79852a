"""The actuator of one unit of the machine, as its seed draws it.

It is deliberately richer than any estimator of this project: forty play operators on thresholds of no one's grid, a
tanh envelope on their sum, twelve creep time constants, an amplifier's lag and an output-side mode (class of
Kuhnen's modified Prandtl-Ishlinskii operator with linear creep). It is scaled to the 445 µm at 150 V of
Muralidhara et al. 2009, §2.1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmctl.simulator import kernel as k

Floats = NDArray[np.float64]

PLAYS = 40
PLAY_SPAN_V = 62.0
REVERSIBLE_SHARE = 0.48
PLAY_DENSITY_V = 26.0  # e-folding of the weights over the threshold
GAIN_UM_PER_V = 2.70  # sum of the weights: 445 µm peak to peak from 0 to 150 V in 100 s
CREEP_TERMS = 12
CREEP_FIRST_S = 0.0063
CREEP_RATIO = 3.17
CREEP_PER_DECADE = 0.030
ENVELOPE_UM, ENVELOPE_CENTRE_UM, ENVELOPE_WIDTH_UM = 22.0, 190.0, 120.0
AMPLIFIER_LAG_S = 0.002
MODE_HZ, MODE_DAMPING = 320.0, 0.04  # loaded output-side resonance [assumed]


def build_actuator(build: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw this unit's play bank (threshold, weight, state) and creep bank (decay, weight, state)."""
    thresholds = PLAY_SPAN_V * ((np.arange(PLAYS) + 0.37) / PLAYS) ** 1.35
    thresholds *= 1.0 + 0.03 * build.standard_normal(PLAYS)
    weights = np.exp(-thresholds / PLAY_DENSITY_V) * (1.0 + 0.1 * build.standard_normal(PLAYS))
    weights *= (1.0 - REVERSIBLE_SHARE) / weights.sum()
    thresholds.sort()
    thresholds[0] = 0.013
    weights[0] += REVERSIBLE_SHARE
    weights *= GAIN_UM_PER_V * (1.0 + 0.01 * build.standard_normal())
    taus = CREEP_FIRST_S * CREEP_RATIO ** np.arange(CREEP_TERMS)
    creep_weights = (
        CREEP_PER_DECADE * math.log10(CREEP_RATIO) * (1.0 + 0.1 * build.standard_normal(CREEP_TERMS))
    )
    plays = np.stack([thresholds, weights, np.zeros(PLAYS)])
    creep = np.stack([np.exp(-k.TICK_S / taus), creep_weights, np.zeros(CREEP_TERMS)])
    return plays, creep


def set_actuator(par: Floats, st: Floats, plays: Floats, creep: Floats) -> None:
    """Set its constants, and leave it as after yesterday's work: cycled over the full range, at 0 V, creep gone."""
    par[k.AMPLIFIER_DECAY] = math.exp(-k.TICK_S / AMPLIFIER_LAG_S)
    par[k.ENVELOPE_UM], par[k.ENVELOPE_CENTRE] = ENVELOPE_UM, ENVELOPE_CENTRE_UM
    par[k.ENVELOPE_STEEPNESS] = 2.0 / ENVELOPE_WIDTH_UM
    omega, zeta = 2.0 * math.pi * MODE_HZ, MODE_DAMPING
    damped = omega * math.sqrt(1.0 - zeta**2)
    decay = math.exp(-zeta * omega * k.TICK_S)
    cos, sin = math.cos(damped * k.TICK_S), math.sin(damped * k.TICK_S)
    par[k.MODE_A11] = decay * (cos + zeta * omega / damped * sin)
    par[k.MODE_A12] = decay * sin / damped
    par[k.MODE_A21] = -decay * omega**2 / damped * sin
    par[k.MODE_A22] = decay * (cos - zeta * omega / damped * sin)
    thresholds, states = plays[0], plays[2]
    for u in (150.0, 0.0, 150.0, 0.0):
        np.clip(states, u - thresholds, u + thresholds, out=states)
    y = float(plays[1] @ states)
    st[k.PLAY_SUM] = y
    y += ENVELOPE_UM * math.tanh((y - ENVELOPE_CENTRE_UM) / ENVELOPE_WIDTH_UM)
    creep[2] = y
    par[k.ACTUATOR_ZERO] = y * (1.0 + float(creep[1].sum()))
