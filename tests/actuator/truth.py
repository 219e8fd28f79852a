"""A made-up actuator outside the estimator's class, and the waveforms it is driven by.

Off-grid plays and creep, a tanh asymmetry of the envelope and sensor noise: an estimator that is exact on its
own class must still meet something it cannot represent.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE_HZ = 100.0
STROKE_UM = 445.0
THRESHOLDS_V = (0.0, 1.7, 3.3, 5.9, 8.7, 11.6, 14.9, 18.3, 22.7, 27.1, 37.3, 51.7)
WEIGHTS_UM_PER_V = (
    1.5891,
    0.1214,
    0.1214,
    0.1325,
    0.1325,
    0.1325,
    0.1545,
    0.1766,
    0.1766,
    0.1766,
    0.0493,
    0.0352,
)
CREEP_TAUS_S = (0.013, 0.07, 0.33, 1.7, 8.1, 37.0, 171.0, 903.0)
CREEP_SHARE = 0.021
ASYMMETRY = 0.02
NOISE_UM = 0.15


def true_displacement(actuator_v: Array) -> Array:
    """Displacement of the made-up actuator, sampled at RATE_HZ, from rest at the first voltage."""
    smooth = np.zeros(len(actuator_v))
    for threshold_v, weight in zip(THRESHOLDS_V, WEIGHTS_UM_PER_V, strict=True):
        smooth += weight * play(actuator_v, threshold_v)
    crept = smooth.copy()
    for tau_s in CREEP_TAUS_S:
        crept += CREEP_SHARE * lag(smooth, tau_s)
    return crept + ASYMMETRY * STROKE_UM * np.tanh(2.0 * (crept / STROKE_UM - 0.5))


def play(actuator_v: Array, threshold_v: float) -> Array:
    """One play operator, written out."""
    out = np.empty_like(actuator_v)
    z = float(actuator_v[0])
    for k, u in enumerate(actuator_v.tolist()):
        z = max(u - threshold_v, min(u + threshold_v, z))
        out[k] = z
    return out


def lag(signal: Array, tau_s: float) -> Array:
    """First-order lag at RATE_HZ, settled at the first value."""
    gain = 1.0 - math.exp(-1.0 / (RATE_HZ * tau_s))
    out = np.empty_like(signal)
    state = float(signal[0])
    for k, value in enumerate(signal.tolist()):
        out[k] = state
        state += gain * (value - state)
    return out


def ramps(*points: tuple[float, float]) -> Array:
    """Voltage through straight lines from 0 V; each point is (volts, seconds to get there)."""
    parts, last_v = [], 0.0
    for volts, seconds in points:
        parts.append(np.linspace(last_v, volts, round(seconds * RATE_HZ) + 1)[1:])
        last_v = volts
    return np.concatenate(parts)


def conditioning(peak_v: float = 150.0, leg_s: float = 4.5) -> Array:
    """Two full triangles."""
    return ramps((peak_v, leg_s), (0.0, leg_s), (peak_v, leg_s), (0.0, leg_s))


def job() -> Array:
    """A touch, 700 s of slow feed under a small servo dither, and two closing touches."""
    feed = ramps((30.0, 5.0), (110.0, 700.0))
    feed[500:] += 0.3 * np.sin(0.3 * np.arange(len(feed) - 500))
    before = ramps((0.0, 5.0), (25.0, 7.0), (0.0, 2.0), (0.0, 10.0))
    after = 110.0 + ramps(
        (-110.0, 1.0), (-110.0, 5.0), (-25.0, 5.0), (-25.0, 1.0), (-110.0, 1.0), (-65.0, 10.0)
    )
    return np.concatenate([before, feed, after])


def clock(samples: int, start_s: float = 0.0) -> Array:
    """Sample times at RATE_HZ."""
    return start_s + np.arange(samples) / RATE_HZ
