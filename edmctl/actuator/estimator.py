"""Displacement from actuator voltage alone.

A Prandtl-Ishlinskii model (weighted plays) with logarithmic creep, identified from one record and continued
from where that record ended, because what the actuator remembers is half of what it does: started without
memory, a model is wrong by half the loop's width until the first full swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from .nnls import nnls
from .operators import BankKernel, BankShape, BankState, compiled_bank

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

PLAYS = 10
THRESHOLD_EXPONENT = 1.4
"""Thresholds lie denser near zero, where the weights of soft PZT are largest."""
CREEPING_PLAYS = (2,)
"""Creep follows the hysteresis' output; this play's threshold, 5 % of the span, is the weighted mean threshold
of soft PZT. One creeping play, because a short record cannot say how creep is shared among several."""
TIME_CONSTANTS_S = tuple(0.04 * 5.0**j for j in range(7))
"""0.04 s to 625 s in steps of 5: within 0.6 % of a decade's creep of the logarithm of time."""
MINIMUM_SAMPLES = 100


class DisplacementEstimator(Protocol):
    """Says where the tool is from what was applied to the actuator."""

    def advance(self, time_s: Array, actuator_v: Array) -> Array:
        """Return the displacement in µm, shape (n,), at consecutive samples; remembers across calls."""
        ...


@dataclass(slots=True)
class PlayEstimator:
    """Prandtl-Ishlinskii model with creep and the state it has reached.

    Feed it every turning point of the voltage: samples that skip one leave the plays where the samples
    went, not where the actuator did. It does not know temperature, load or driver error.

    weights_um_per_v : ndarray, shape (shape.features,), all ≥ 0
    """

    shape: BankShape
    weights_um_per_v: Array
    offset_um: float
    state: BankState
    kernel: BankKernel

    def advance(self, time_s: Array, actuator_v: Array) -> Array:
        """Return the displacement in µm, shape (n,), at consecutive samples.

        time_s, actuator_v : ndarray, shape (n,); time runs on from the record the model was identified from.
        """
        if not len(time_s):
            return np.empty(0)
        _, displacement_um = _run(
            self.kernel, self.shape, self.state, self.weights_um_per_v, time_s, actuator_v
        )
        displacement_um += self.offset_um
        return displacement_um


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """An identified model and how well it fits its own record (not how well it will predict)."""

    model: PlayEstimator
    rms_um: float
    max_um: float


def identify_play_model(time_s: Array, actuator_v: Array, displacement_um: Array) -> IdentificationResult:
    """Fit a Prandtl-Ishlinskii model with creep by non-negative least squares.

    time_s, actuator_v, displacement_um : ndarray, shape (n,). A record of full swings 0 … V_max that starts
    after a rest. The rise to the first maximum is not fitted: before it the plays depend on a history that
    nobody recorded; from it on every play up to V_max/2 is where the record put it.

    The model's state is the one at the end of the record. Raises ValueError when fewer than 100 samples
    follow the first maximum, or the voltage does not change.
    """
    shape = _shape_for(actuator_v)
    first = int(np.argmax(actuator_v >= actuator_v.max() - 0.01 * np.ptp(actuator_v)))
    if len(actuator_v) - first < MINIMUM_SAMPLES:
        raise ValueError(
            f"{len(actuator_v) - first} samples after the first maximum, at least {MINIMUM_SAMPLES} needed"
        )
    state = BankState.at_rest(shape, float(actuator_v[0]), float(time_s[0]))
    kernel = compiled_bank()
    features, _ = _run(kernel, shape, state, np.zeros(shape.features), time_s, actuator_v)
    weights, offset_um = _fit(features[first:], displacement_um[first:])
    residual_um = features[first:] @ weights + offset_um - displacement_um[first:]
    return IdentificationResult(
        PlayEstimator(shape, weights, offset_um, state, kernel),
        float(np.sqrt(np.mean(residual_um**2))),
        float(np.abs(residual_um).max()),
    )


def _shape_for(actuator_v: Array) -> BankShape:
    span_v = float(np.ptp(actuator_v))
    if span_v <= 0.0:
        raise ValueError("the actuator voltage of the record does not change")
    thresholds_v = span_v / 2 * (np.arange(PLAYS) / PLAYS) ** THRESHOLD_EXPONENT
    return BankShape(thresholds_v, np.array(CREEPING_PLAYS), np.array(TIME_CONSTANTS_S))


def _run(
    kernel: BankKernel, shape: BankShape, state: BankState, weights: Array, time_s: Array, actuator_v: Array
) -> tuple[Array, Array]:
    """Advance `state`; return features (n, f) and their weighted sum (n,)."""
    features = np.empty((len(time_s), shape.features))
    output = np.empty(len(time_s))
    kernel(
        time_s,
        actuator_v,
        state.time_s,
        shape.thresholds_v,
        shape.creeping,
        shape.time_constants_s,
        state.plays_v,
        state.creep_v,
        weights,
        features,
        output,
    )
    state.time_s = float(time_s[-1])
    return features, output


def _fit(features: Array, displacement_um: Array) -> tuple[Array, float]:
    """Return non-negative weights and a free offset; the offset is fitted by removing every column's mean."""
    mean = features.mean(axis=0)
    scale = np.abs(features).max(axis=0)
    centred = (features - mean) / scale
    weights = nnls(centred, displacement_um - displacement_um.mean()) / scale
    return weights, float(displacement_um.mean() - mean @ weights)
