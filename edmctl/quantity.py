"""Values with their uncertainty, and the one quantile function that turns it into an interval."""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist
from typing import Any

from edmctl.dataclasses import dataclass

_PANELS = 64
"""Panels of Simpson's rule: quantiles up to 95 % are within 1e-5."""


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


@lru_cache(4096)
def coverage_factor(p: float, dof: float = math.inf) -> float:
    """Return the two-sided quantile of Student's t distribution at probability `p`, normal where `dof` is infinite.

    Newton's method from the normal quantile, which is below it. The distribution function is the integral of
    cos(a)^(dof - 1) over a = atan(t / sqrt(dof)). Written out because a run starts without SciPy (decision 0009).
    Raises ValueError if `p` is not between 0 and 1 or `dof` is below 1.
    """
    if not 0.0 < p < 1.0 or not dof >= 1.0:
        raise ValueError(f"no interval with probability {p} and {dof} degrees of freedom")
    t = NormalDist().inv_cdf(0.5 + 0.5 * p)
    if dof > 1e6:
        return t
    scale = 2.0 * math.exp(math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)) / math.sqrt(math.pi)
    for _ in range(50):  # it takes 10 at most, but rounding may keep the last steps from becoming smaller
        width = math.atan(t / math.sqrt(dof)) / _PANELS
        weights = (1.0 if i in (0, _PANELS) else 2.0 + 2.0 * (i % 2) for i in range(_PANELS + 1))
        inside = (
            math.fsum(w * math.cos(i * width) ** (dof - 1.0) for i, w in enumerate(weights)) * width / 3.0
        )
        density = (1.0 + t * t / dof) ** (-0.5 * (dof + 1.0)) / math.sqrt(dof)
        step = (p / scale - inside) / density
        t += step
        if abs(step) < 1e-8 * t:
            break
    return t
