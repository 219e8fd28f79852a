"""The lever factor D_a of the flexure: tool displacement over stack displacement.

Muralidhara et al. 2009, §2.1: the amplification is linear, about 18, from a linear fit.
"""

from __future__ import annotations

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.errors import RecordError

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

    The uncertainty of the straight line assumes independent residuals; those of a slow measurement drift and
    curve together, so that n samples are worth only n/τ, with τ their autocorrelation time.

    Raises RecordError when the samples are too few, not finite, do not move, or cannot be those of a lever.
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
        what = f"{stack.size} samples of the stacks' displacement, but {tool.size} of the tool's"
        raise RecordError(what, hint="Record both at the same instants.", code="E3620")
    if len(stack) < LEAST_SAMPLES:
        what = f"{len(stack)} samples are too few for a lever factor, at least {LEAST_SAMPLES} are needed"
        raise RecordError(what, hint="Record a slow swing over the whole range.", code="E3621")
    if len(wrong := np.flatnonzero(~(np.isfinite(stack) & np.isfinite(tool)))):
        what = f"sample {wrong[0] + 1} of the displacements is not a finite number"
        raise RecordError(what, hint="Remove the samples that the sensor could not measure.", code="E3622")
    if not np.ptp(stack) > 0.0:
        what = f"the stacks' displacement stays at {stack[0]:g} µm"
        hint = "Drive the actuator over its range while both sensors are read."
        raise RecordError(what, hint=hint, code="E3623")


def _refuse_factor(factor: float) -> None:
    if factor < 0.0:
        what = f"the tool moves back while the stacks extend (factor {factor:.3g})"
        raise RecordError(what, hint="Reverse the sign of one of the two sensors.", code="E3624")
    if not LEAST_FACTOR < factor < LARGEST_FACTOR:
        what = f"a lever factor of {factor:.3g} is not that of a flexure (paper: 18)"
        hint = "Give both displacements in µm, and the stacks' and the tool's in the right columns."
        raise RecordError(what, hint=hint, code="E3625")
