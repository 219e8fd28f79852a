"""What an identified actuator is measured against: a straight line, and the paper's own class of model.

Both are corners of the class of `model`, identified and judged by the same code on the same held-out blocks:
one play of threshold 0 is the straight line, ten plays without hinges and without creep are the Maxwell slip
model of Muralidhara et al. 2009, §2.1, in its equivalent form (`maxwell`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.actuator.design import PLAYS
from edmctl.actuator.identification import FOLDS, identify

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record
    from edmctl.actuator.validation import ErrorFigures

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Baseline:
    """A simpler model of the same records.

    train, held_out : its errors on the records, and on contiguous blocks of them that it did not see.
    """

    model: ActuatorModel
    train: ErrorFigures
    held_out: ErrorFigures

    def predict(self, t_s: Array, u_v: Array, previous_v: float | None = None) -> Array:
        """Displacement in µm, shape (n,).

        previous_v : what the actuator was held at before the first sample; None: it had been cycling.
        """
        return self.model.predict(t_s, u_v, self.model.starting_state(t_s, u_v, previous_v))


def fit_line(records: Sequence[Record], folds: int = FOLDS, delay_s: float = 0.0) -> Baseline:
    """Fit a straight line, displacement = gain · voltage + zero. Raises ValueError as `identify` does."""
    return _fit(records, plays=1, folds=folds, delay_s=delay_s)


def fit_maxwell(records: Sequence[Record], folds: int = FOLDS, delay_s: float = 0.0) -> Baseline:
    """Fit a Maxwell slip model with ten elements. Raises ValueError as `identify` does."""
    return _fit(records, plays=PLAYS, folds=folds, delay_s=delay_s)


def paper_practice(slow_cycle: Record) -> Baseline:
    """Fit the paper's model the way the paper uses it: to one slow cycle, for everything that follows.

    slow_cycle : one full swing of 10 mHz or so, of a conditioned actuator.
    """
    return fit_maxwell([slow_cycle])


def _fit(records: Sequence[Record], *, plays: int, folds: int, delay_s: float) -> Baseline:
    found = identify(records, hinges=1, plays=plays, creep=False, delay_s=delay_s, folds=folds, resamples=0)
    return Baseline(found.model, found.train, found.held_out)
