"""The actuator of one unit of the machine, as its seed draws it.

It is deliberately richer than any estimator of this project: forty play operators on thresholds of no one's grid, a
tanh envelope on their sum, twelve creep time constants, an amplifier's lag and an output-side mode (class of
Kuhnen's modified Prandtl-Ishlinskii operator with linear creep). It is scaled to the 445 µm at 150 V of
Muralidhara et al. 2009, §2.1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.simulator.plant_interface import TICK_S
from edmctl.simulator.plant_state import CREEP_TERMS, PLAYS

if TYPE_CHECKING:
    from edmctl.simulator.plant_state import PlantState, Unit

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
    thresholds = PLAY_SPAN_V * ((np.arange(PLAYS) + 0.37) / PLAYS) ** 1.35
    thresholds *= 1.0 + 0.03 * build.standard_normal(PLAYS)
    weights = np.exp(-thresholds / PLAY_DENSITY_V) * (1.0 + 0.1 * build.standard_normal(PLAYS))
    weights *= (1.0 - REVERSIBLE_SHARE) / weights.sum()
    thresholds.sort()
    thresholds[0] = 0.013
    weights[0] += REVERSIBLE_SHARE
    weights *= GAIN_UM_PER_V * (1.0 + 0.01 * build.standard_normal())
    taus = CREEP_FIRST_S * CREEP_RATIO ** np.arange(CREEP_TERMS)
    creep_shares = (
        CREEP_PER_DECADE * math.log10(CREEP_RATIO) * (1.0 + 0.1 * build.standard_normal(CREEP_TERMS))
    )
    unit.array("play_threshold_v")[:] = thresholds
    unit.array("play_um_per_v")[:] = weights
    unit.array("creep_decay")[:] = np.exp(-TICK_S / taus)
    unit.array("creep_share")[:] = creep_shares


def set_actuator(unit: Unit, state: PlantState) -> None:
    """Set its constants, and leave it as after yesterday's work: cycled over the full range, at 0 V, creep gone."""
    unit.amplifier_decay = math.exp(-TICK_S / AMPLIFIER_LAG_S)
    unit.envelope_um, unit.envelope_centre_um = ENVELOPE_UM, ENVELOPE_CENTRE_UM
    unit.envelope_steepness = 2.0 / ENVELOPE_WIDTH_UM
    omega, zeta = 2.0 * math.pi * MODE_HZ, MODE_DAMPING
    damped = omega * math.sqrt(1.0 - zeta**2)
    decay = math.exp(-zeta * omega * TICK_S)
    cos, sin = math.cos(damped * TICK_S), math.sin(damped * TICK_S)
    unit.mode_a11 = decay * (cos + zeta * omega / damped * sin)
    unit.mode_a12 = decay * sin / damped
    unit.mode_a21 = -decay * omega**2 / damped * sin
    unit.mode_a22 = decay * (cos - zeta * omega / damped * sin)
    thresholds, plays = unit.array("play_threshold_v"), state.array("play_v")
    for u in (150.0, 0.0, 150.0, 0.0):
        np.clip(plays, u - thresholds, u + thresholds, out=plays)
    y = float(unit.array("play_um_per_v") @ plays)
    state.play_sum_um = y
    y += ENVELOPE_UM * math.tanh((y - ENVELOPE_CENTRE_UM) / ENVELOPE_WIDTH_UM)
    state.array("creep_um")[:] = y
    unit.actuator_zero_um = y * (1.0 + float(unit.array("creep_share").sum()))
