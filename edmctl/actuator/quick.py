"""Identification of a plain actuator model in milliseconds, from the few swings before a job."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edmctl.actuator.fitting import TAU_RATIO, Design, fit, knots, reduce_records, thresholds
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import LEAST_SAMPLES, Record, check_numbers
from edmctl.actuator.validation import ErrorFigures, figures
from edmctl.start_up import one_blas_thread

QUICK_PLAYS = 12
QUICK_CREEPING = 2  # the play that creeps. Its threshold is 4 % of the span.
QUICK_PIECES = 3  # pieces per play. One piece cannot bend: depths of 180 µm came out 1.7 µm too small.
QUICK_TAUS_S = 0.04 * np.power(TAU_RATIO, np.arange(7.0))


@one_blas_thread()
def identify_quick(record: Record) -> tuple[ActuatorModel, ErrorFigures]:
    """Identify a plain model from a few full swings, in milliseconds; with its errors on the record itself.

    Creep follows one play like the logarithm of time, because a short record cannot show more. The rise to the first
    maximum is not fitted: before it the plays depend on an unrecorded history. Raises ValueError as `refuse` does,
    and where too few samples follow.
    """
    refuse([record])
    low_v, high_v = float(record.u_v.min()), float(record.u_v.max())
    thresholds_v = thresholds(high_v - low_v, QUICK_PLAYS)
    design = Design(
        thresholds_v=thresholds_v,
        knots_v=knots(thresholds_v, low_v, high_v, QUICK_PIECES),
        creep_plays=np.array([QUICK_CREEPING], dtype=np.int64),
        time_constants_s=QUICK_TAUS_S,
        column_of=np.zeros(len(QUICK_TAUS_S), dtype=np.int64),
        low_v=low_v,
        high_v=high_v,
    )
    first = int(np.argmax(record.u_v >= high_v - 0.01 * (high_v - low_v)))
    if len(record.t_s) - first < LEAST_SAMPLES // 2:
        raise ValueError(
            f"{record.name}: {len(record.t_s) - first} samples after the first maximum are too few"
        )
    used = np.arange(len(record.t_s)) >= first
    reduction = reduce_records(design, [record], [0.0], [used])
    best = fit(reduction)
    model = reduction.model(best.weights, float(best.zeros_um[0]))
    return model, figures(reduction, model, best)


def refuse(records: Sequence[Record]) -> None:
    """Raise ValueError for records that nothing can be identified from."""
    if not records:
        raise ValueError("no record to identify from")
    for record in records:
        if len(record.t_s) < LEAST_SAMPLES:
            raise ValueError(f"{record.name}: {len(record.t_s)} samples, at least {LEAST_SAMPLES} are needed")
        check_numbers(record)
        if record.previous_v is not None and not np.isfinite(record.previous_v):
            raise ValueError(f"{record.name}: the voltage before it is not finite")
        if not np.ptp(record.u_v) > 0.0:
            raise ValueError(f"{record.name}: the voltage does not change")
        if not (np.diff(record.t_s) > 0.0).all():
            raise ValueError(f"{record.name}: time does not ascend")
        if not float(np.cov(record.u_v, record.y_um)[0, 1]) > 0.0:
            raise ValueError(f"{record.name}: the displacement does not rise with the voltage")
