"""From records to the triangles of a linear least-squares problem, block by block.

A model is linear in its weights once thresholds, knots and time constants are chosen, so a record of any
length is worth only the triangular factor R of [features | displacement]. Records are cut into contiguous
blocks with a triangle each: every fit, fold and resample afterwards is a choice among them, and never touches
the samples again.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.triangles import triangle_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

BLOCKS = 64


@dataclass(frozen=True, slots=True)
class Design:
    """What a model is to be made of; the weights are open.

    column_of : ndarray of int, shape (j,)
        Lags with the same number get the same weight.
    """

    thresholds_v: Array
    knots_v: Array
    creep_plays: NDArray[np.int64]
    time_constants_s: Array
    column_of: NDArray[np.int64]
    low_v: float
    high_v: float

    @property
    def creep_columns(self) -> int:
        """Columns of creep per creeping play."""
        return int(self.column_of.max(initial=-1)) + 1

    @property
    def features(self) -> int:
        """Weights to be found."""
        plays, pieces = len(self.thresholds_v), self.knots_v.shape[1] - 1
        features: int = plays * pieces + len(self.creep_plays) * self.creep_columns
        return features

    @property
    def first_play(self) -> slice:
        """Features of the play of threshold 0, whose slopes have a floor."""
        return slice(0, self.knots_v.shape[1] - 1)

    def model(self, weights: Array, zero_um: float, delay_s: float) -> ActuatorModel:
        """Return the model with these weights, shape (features,)."""
        plays, pieces = len(self.thresholds_v), self.knots_v.shape[1] - 1
        creep = weights[plays * pieces :].reshape(len(self.creep_plays), self.creep_columns)
        return ActuatorModel(
            thresholds_v=self.thresholds_v,
            knots_v=self.knots_v,
            slopes_um_per_v=weights[: plays * pieces].reshape(plays, pieces).copy(),
            creep_plays=self.creep_plays,
            time_constants_s=self.time_constants_s,
            creep_um_per_v=np.ascontiguousarray(creep[:, self.column_of]),
            zero_um=zero_um,
            delay_s=delay_s,
            low_v=self.low_v,
            high_v=self.high_v,
        )


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive samples of one record, reduced.

    triangle : ndarray, shape (at most c, c)
        R of [one column of ones per record | features | displacement advanced by each delay].
    record, first, end : which record, which of its samples.
    """

    triangle: Array
    samples: int
    record: int
    first: int
    end: int


@dataclass(frozen=True, slots=True)
class Reduction:
    """Records under a design.

    sketch : ndarray, shape (about 500, features)
        Features of evenly spread samples, to see what weights mean for the displacement.
    """

    blocks: tuple[Block, ...]
    sketch: Array
    records: int


def reduce_records(
    design: Design, records: Sequence[Record], delays_s: Array, skip: Sequence[int]
) -> Reduction:
    """Reduce the records; `skip` samples at the start of each, and those after its end less the last delay.

    The displacement is advanced by each of `delays_s`, shape (k,), so that one pass serves a whole search.
    """
    total = sum(len(record.t_s) for record in records)
    blocks: list[Block] = []
    sketches: list[Array] = []
    for number, record in enumerate(records):
        features = _features(design, record)
        rows = np.zeros((len(record.t_s), len(records) + design.features + len(delays_s)))
        rows[:, number] = 1.0
        rows[:, len(records) : len(records) + design.features] = features
        for k, delay_s in enumerate(delays_s):
            rows[:, len(records) + design.features + k] = np.interp(
                record.t_s + delay_s, record.t_s, record.y_um
            )
        end = int(np.searchsorted(record.t_s, record.t_s[-1] - delays_s.max(), side="right"))
        count = max(1, round(BLOCKS * len(record.t_s) / total))
        edges = np.linspace(skip[number], end, count + 1).astype(int).tolist()
        blocks += [Block(triangle_of(rows[a:b]), b - a, number, a, b) for a, b in pairwise(edges) if b > a]
        sketches.append(features[:: max(1, total // 500)])
    return Reduction(tuple(blocks), np.concatenate(sketches), len(records))


def _features(design: Design, record: Record) -> Array:
    from edmctl.actuator.operators import bank_features

    weights = np.zeros(design.features)
    weights[design.first_play] = 1.0
    state = design.model(weights, 0.0, 0.0).starting_state(record.t_s, record.u_v, record.previous_v)
    features = np.empty((len(record.t_s), design.features))
    bank_features(
        np.ascontiguousarray(record.t_s, dtype=np.float64),
        np.ascontiguousarray(record.u_v, dtype=np.float64),
        state.t_s,
        design.thresholds_v,
        design.knots_v,
        design.creep_plays,
        design.time_constants_s,
        design.column_of,
        state.plays_v,
        state.lags_v,
        np.empty((3, len(design.time_constants_s))),
        features,
    )
    return features
