"""The lever factor: displacement of the tool over that of the piezo stacks, with its uncertainty."""

from __future__ import annotations

import numpy as np

from edmctl import failures
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

LEAST_SAMPLES = 10
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
    _refuse(stack, tool)
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


def _refuse(stack: Array, tool: Array) -> None:
    if stack.shape != tool.shape or stack.ndim != 1:
        raise failures.lever_lengths_differ(stack_samples=stack.size, tool_samples=tool.size)
    if len(stack) < LEAST_SAMPLES:
        raise failures.lever_samples_too_few(stack_count=len(stack), least_samples=LEAST_SAMPLES)
    if len(wrong := np.flatnonzero(~(np.isfinite(stack) & np.isfinite(tool)))):
        raise failures.lever_sample_not_finite(wrong=wrong[0] + 1)
    if not np.ptp(stack) > 0.0:
        raise failures.lever_at_rest(stack=stack[0])


def _refuse_factor(factor: float) -> None:
    if factor < 0.0:
        raise failures.lever_reversed(factor=factor)
    if not LEAST_FACTOR < factor < LARGEST_FACTOR:
        raise failures.lever_factor_impossible(factor=factor)
