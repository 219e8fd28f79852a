"""Values with their uncertainty, and the one quantile function that turns it into an interval."""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist
from typing import Any

from edmctl.dataclasses import dataclass

LARGE_DOF = 1e5
"""From here on the normal quantile with one term of its expansion in 1 / dof is within 1e-9."""


@dataclass(frozen=True, slots=True)
class Value:
    """An estimate with its standard uncertainty `u`, in its unit, and the degrees of freedom of that uncertainty."""

    value: float
    u: float
    dof: float = math.inf

    @property
    def u95(self) -> float:
        """Half width of the 95 % interval."""
        return half_width(self.u, self.dof)

    def widened(self, u: float) -> Value:
        """Return the same with an independent standard uncertainty `u` added, of infinite degrees of freedom."""
        combined = math.hypot(self.u, u)
        dof = self.dof * (combined / self.u) ** 4 if self.u > 0.0 else math.inf
        return Value(self.value, combined, dof)

    def columns(self, name: str) -> dict[str, Any]:
        """Return estimate, u95 and u by the names of a result's fields: `name` is such as "depth_{}um"."""
        return {name.format(""): self.value, name.format("u95_"): self.u95, name.format("u_"): self.u}

    def interval(self, p: float = 0.95) -> tuple[float, float]:
        """Return the limits between which the true value lies with probability `p`."""
        half = half_width(self.u, self.dof, p)
        return self.value - half, self.value + half


def half_width(u: float, dof: float = math.inf, p: float = 0.95) -> float:
    """Return half the width of the interval that contains the true value with probability `p`."""
    return coverage_factor(p, dof) * u


@lru_cache
def _gauss_legendre() -> tuple[Any, Any]:
    from numpy.polynomial.legendre import leggauss

    return leggauss(48)


@lru_cache(4096)
def coverage_factor(p: float, dof: float = math.inf) -> float:
    """Return the two-sided quantile of Student's t distribution at probability `p`, within 1e-9.

    Newton's method from the normal quantile, which is below it. The distribution function is the integral of
    cos(a)^(dof - 1) over a = atan(t / sqrt(dof)), here by Gauss and Legendre. `scipy.special.stdtrit` returns the
    same, but importing it takes 0.15 s of the 1.0 s of a short job (decision 0009).
    Raises ValueError if `p` is not between 0 and 1 or `dof` is below 1.
    """
    if not 0.0 < p < 1.0 or not dof >= 1.0:
        raise ValueError(f"no interval with probability {p} and {dof} degrees of freedom")
    t = NormalDist().inv_cdf(0.5 + 0.5 * p)
    if dof >= LARGE_DOF:
        return t * (1.0 + (t * t + 1.0) / (4.0 * dof))
    import numpy as np  # the forecast of a job needs normal quantiles only

    nodes, weights = _gauss_legendre()
    scale = 2.0 * math.exp(math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)) / math.sqrt(math.pi)
    step = t
    while abs(step) > 1e-10 * t:
        half = 0.5 * math.atan(t / math.sqrt(dof))
        inside = scale * half * float(weights @ np.cos(half * (1.0 + nodes)) ** (dof - 1.0))
        density = scale / math.sqrt(dof) * (1.0 + t * t / dof) ** (-0.5 * (dof + 1.0))
        step = (p - inside) / density
        t += step
    return t
