"""Identification of an actuator model from measured records, with held-out errors and bands of uncertainty.

Thresholds, knots and time constants are chosen from the range of the records; the weights solve one convex problem
(`fitting`) on triangles of the data (`design`). The baselines are special cases of the same class: one play of
threshold 0 is the straight line; ten plays without hinges and creep are the Maxwell slip model of Muralidhara et al.
2009, §2.1 (`paper_model`).

The lever factor is the displacement of the tool over that of the piezo stacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.actuator.acceptance import DIFFERING, Left, Noise, notes_on, problems_of, restrictions_on
from edmctl.actuator.fitting import (
    BLOCKS,
    HINGES,
    PLAYS,
    Design,
    Reduction,
    choose_design,
    fit,
    reduce_records,
)
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.quick import refuse
from edmctl.actuator.record import Record, half_periods_s, sample_s
from edmctl.actuator.screening import PASSES, Screening, residual_um, screened, settled, suspects
from edmctl.actuator.search import extended, vertex_delay_s
from edmctl.actuator.validation import (
    Bands,
    ErrorFigures,
    apart,
    bands_of,
    figures,
    held_out_of,
    smoothest,
    whole_records,
)
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.start_up import one_blas_thread

FOLDS, RESAMPLES = 8, 40
LONGEST_FIXED_DELAY_S = 1.0
LONGEST_DELAY_S = 0.02
DELAY_STEPS = 16
NO_NOISE = Noise(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Identification:
    """A model, how well it does on blocks it did not see, and what stands against using it.

    train : errors on the records themselves
    held_out : errors of blocked cross-validation, of what lies within what the other blocks reached
    problems : reasons against using it, each with its remedy; empty: accepted
    restrictions : what the acceptance is limited to, each continues "accepted"
    notes : what else a reader should know
    held_out_model : the same without the sensor's noise: what the model itself misses
    noise : what the sensor's noise alone comes to
    beyond, beyond_share : held-out errors of the rest, which is extrapolation, and its share; None: no such
    screening : which samples count
    held_out_records : errors of whole records that were held out; None: no record is like the others
    """

    model: ActuatorModel
    train: ErrorFigures
    held_out: ErrorFigures
    held_out_model: ErrorFigures
    bands: Bands
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    samples: int
    noise: Noise = NO_NOISE
    beyond: ErrorFigures | None = None
    beyond_share: float = 0.0
    screening: Screening | None = None
    restrictions: tuple[str, ...] = ()
    held_out_records: ErrorFigures | None = None

    @property
    def stroke_um(self) -> float:
        """Displacement from trough to crest of a slow full cycle, µm."""
        return self.model.stroke_um

    @property
    def accepted(self) -> bool:
        """Whether nothing stands against using the model."""
        return not self.problems


@one_blas_thread()
def identify(
    records: Sequence[Record],
    *,
    hinges: int = HINGES,
    plays: int = PLAYS,
    creep: bool = True,
    beyond_plays: bool = True,
    delay_s: float | None = None,
    folds: int = FOLDS,
    resamples: int = RESAMPLES,
    screening: Screening | None = None,
) -> Identification:
    """Identify an actuator from one or several records of (t_s, u_v, y_um, previous_v, name).

    hinges : pieces per play; 1 gives the Prandtl-Ishlinskii operator, the class of the paper's Maxwell model
    creep : whether the model creeps
    beyond_plays : whether a rounded play and a lag are looked for, taken where they predict clearly better, and
        samples that do not count; False for a class that is not meant to follow everything
    delay_s : fixed delay; None searches 0 … 20 ms
    folds, resamples : of the blocked cross-validation and of the block bootstrap
    screening : samples that count, where another model of the same records has found that; None looks for them

    Every record gets its own zero; the model takes that of the last. Raises ValueError when no sample is left
    to fit, the voltage never changes, or the displacement does not rise with it.
    """
    if isinstance(records, Record):
        raise ValueError("identify takes a list of records: identify([record])")
    if delay_s is not None and not 0.0 <= delay_s <= LONGEST_FIXED_DELAY_S:
        raise ValueError(f"a delay lies between 0 and {LONGEST_FIXED_DELAY_S:g} s: {delay_s}")
    if min(hinges, plays) < 1 or not 2 <= folds <= BLOCKS or resamples < 0:
        raise ValueError(
            f"{hinges} hinges, {plays} plays, {folds} folds and {resamples} resamples do not make a fit"
        )
    records = [_plain(Record(*record)) for record in records]
    refuse(records)
    design = choose_design(records, hinges=hinges, plays=plays, creep=creep)
    counting = settled(records) if screening is None else screening
    found_s = best_delay(design, records, counting.used) if delay_s is None else delay_s
    if screening is None and beyond_plays:
        counting = _screened(design, records, counting, found_s)
        if delay_s is None and not counting.is_plain:
            found_s = best_delay(design, records, counting.used)
    if beyond_plays:
        design, found_s = extended(design, records, counting.used, found_s, is_fixed=delay_s is not None)
    return _found(reduce_records(design, records, [found_s], counting.used), counting, folds, resamples)


def _found(reduction: Reduction, counting: Screening, folds: int, resamples: int) -> Identification:
    """Fit the reduced records, and judge the model."""
    design, records = reduction.design, reduction.records
    best, held_out = smoothest(reduction, folds)
    bands = bands_of(reduction, best, held_out.errors, resamples)
    model = reduction.model(best.weights, float(best.zeros_um[-1]))
    left = [
        Left.of(record, used, residual_um(model, record))
        for record, used in zip(records, counting.used, strict=True)
    ]
    noise = Noise.of([part.errors_um for part in left])

    def judged_without() -> list[tuple[str, ErrorFigures]]:
        without = []
        for one in suspects(design, best.weights, model, records, counting.used):
            reduced = reduce_records(design, one.records, reduction.delays_s, one.used)
            without.append((one.words, held_out_of(reduced, best.smoothness, folds).errors))
        if len(records) > 1:
            without.append((DIFFERING, apart(reduction, best.smoothness, folds)))
        return without

    whole = whole_records(reduction, best)
    return Identification(
        model=model,
        train=figures(reduction, model, best),
        held_out=held_out.errors,
        held_out_model=held_out.of_model,
        bands=bands,
        problems=problems_of(
            design, records, held_out, whole, left, noise, judged_without, on_floor=best.on_floor
        ),
        notes=(*counting.notes(records), *notes_on(held_out, noise)),
        restrictions=restrictions_on(records),
        samples=sum(block.samples for block in reduction.blocks),
        noise=noise,
        beyond=held_out.beyond,
        beyond_share=held_out.beyond_share,
        screening=counting,
        held_out_records=whole,
    )


def _screened(design: Design, records: Sequence[Record], settled: Screening, delay_s: float) -> Screening:
    """Exclude a ringing start and single outliers, and repeat with a fit to the remaining samples."""
    found = settled
    for _ in range(PASSES):
        reduction = reduce_records(design, records, [delay_s], found.used)
        best = fit(reduction)
        model = reduction.model(best.weights, float(best.zeros_um[-1]))
        before, found = found, screened(model, records, settled)
        if all(np.array_equal(*pair) for pair in zip(before.used, found.used, strict=True)):
            break
    return found


def fit_line(
    records: Sequence[Record], delay_s: float = 0.0, screening: Screening | None = None
) -> Identification:
    """Fit a straight line, displacement = gain · voltage + zero. Raises ValueError as `identify` does."""
    return _plain_fit(records, 1, delay_s, screening)


def fit_maxwell(
    records: Sequence[Record], delay_s: float = 0.0, screening: Screening | None = None
) -> Identification:
    """Fit a Maxwell slip model with ten elements. Raises ValueError as `identify` does.

    The paper fits it to one slow cycle, a full swing of 10 mHz or so of a conditioned actuator, for everything that
    follows.
    """
    return _plain_fit(records, PLAYS, delay_s, screening)


def _plain_fit(
    records: Sequence[Record], plays: int, delay_s: float, screening: Screening | None
) -> Identification:
    plain: dict[str, Any] = {"hinges": 1, "creep": False, "beyond_plays": False, "resamples": 0}
    return identify(records, plays=plays, delay_s=delay_s, screening=screening, **plain)


def _plain(record: Record) -> Record:
    """Return the record with float arrays. Raises ValueError if their shapes differ."""
    arrays = [np.asarray(values, dtype=np.float64) for values in record[:3]]
    if any(values.ndim != 1 or values.shape != arrays[0].shape for values in arrays):
        shapes = ", ".join(str(values.shape) for values in arrays)
        raise ValueError(f"{record.name}: arrays of shape {shapes}, (n,) each is needed")
    return record._replace(t_s=arrays[0], u_v=arrays[1], y_um=arrays[2])


def best_delay(design: Design, records: Sequence[Record], used: Sequence[NDArray[np.bool_]]) -> float:
    """Return the delay that leaves least; those tried are whole samples from -1 on, which average no noise away."""
    step_s = sample_s(records)
    if step_s > LONGEST_DELAY_S:
        return 0.0
    swings_s = np.concatenate([half_periods_s(record) for record in records])
    longest_s = min(LONGEST_DELAY_S, 0.5 * float(swings_s.min(initial=np.inf)))
    stride_s = step_s * max(1, round(longest_s / DELAY_STEPS / step_s))
    delays_s: Array = stride_s * np.arange(-1.0, max(2, round(longest_s / stride_s)) + 1)
    reduction = reduce_records(design, records, delays_s, used)
    residuals: list[float] = []
    weights = None
    for k in range(len(delays_s)):
        found = fit(reduction, delay=k, start=weights)
        weights = found.weights
        residuals.append(found.residual_um2)
    return vertex_delay_s(delays_s, residuals)


LEAST_LEVER_SAMPLES = 10
LEAST_FACTOR, LARGEST_FACTOR = 1.0, 200.0
"""Flexures amplify, by up to a few tens; what lies outside is another unit or another column."""


@dataclass(frozen=True, slots=True)
class Lever:
    """Tool displacement = factor · stack displacement + offset_um.

    sd : standard uncertainty of the factor, with the residuals' autocorrelation taken into account.
    """

    factor: float
    sd: float
    offset_um: float


def lever_factor(x_um: Array, z_um: Array) -> Lever:
    """Fit the lever to displacements of stacks and tool at the same instants, shape (n,) each, in order of time.

    Residuals of a slow measurement drift and curve together: n samples are worth n/τ, with τ their autocorrelation
    time. Raises RecordError when the samples are too few, not finite, do not move, or cannot be those of a lever.
    """
    stack, tool = np.asarray(x_um, dtype=np.float64), np.asarray(z_um, dtype=np.float64)
    _refuse_lever(stack, tool)
    centred = stack - stack.mean()
    square = float(centred @ centred)
    factor = float(centred @ tool) / square
    _refuse_factor(factor)
    offset_um = float(tool.mean() - factor * stack.mean())
    residual = tool - factor * stack - offset_um
    variance = float(residual @ residual) / (len(stack) - 2) / square
    return Lever(factor, float(np.sqrt(variance * autocorrelation_time(residual))), offset_um)


def autocorrelation_time(residual: Array) -> float:
    """Samples that count as one: 1 + 2·Σ of the autocorrelation up to where it first falls to zero."""
    spectrum = np.fft.rfft(residual, 2 * len(residual))
    correlation = np.fft.irfft(spectrum.real**2 + spectrum.imag**2)[: len(residual)]
    if correlation[0] <= 0.0:
        return 1.0
    ends = np.flatnonzero(correlation <= 0.0)
    positive = correlation[1 : ends[0] if len(ends) else None]
    return 1.0 + 2.0 * float(positive.sum() / correlation[0])


def _refuse_lever(stack: Array, tool: Array) -> None:
    if stack.shape != tool.shape or stack.ndim != 1:
        raise failures.lever_lengths_differ(stack_samples=stack.size, tool_samples=tool.size)
    if len(stack) < LEAST_LEVER_SAMPLES:
        raise failures.lever_samples_too_few(stack_count=len(stack), least_samples=LEAST_LEVER_SAMPLES)
    if len(wrong := np.flatnonzero(~(np.isfinite(stack) & np.isfinite(tool)))):
        raise failures.lever_sample_not_finite(wrong=wrong[0] + 1)
    if not np.ptp(stack) > 0.0:
        raise failures.lever_at_rest(stack=stack[0])


def _refuse_factor(factor: float) -> None:
    if factor < 0.0:
        raise failures.lever_reversed(factor=factor)
    if not LEAST_FACTOR < factor < LARGEST_FACTOR:
        raise failures.lever_factor_impossible(factor=factor)
