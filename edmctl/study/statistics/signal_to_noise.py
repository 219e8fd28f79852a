"""Taguchi's signal-to-noise ratios, and what each level of each factor does on average."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from edmctl.dataclasses import dataclass

Better = Literal["larger", "smaller", "nominal"]


def signal_to_noise_db(values: ArrayLike, better: Better) -> float:
    """Return the signal-to-noise ratio of the replicates of one point, in dB; NaN where it is not defined.

    Larger is better: −10 lg mean(1/y²). Smaller is better: −10 lg mean(y²). Nominal is best: 10 lg(mean²/variance),
    for which it takes two replicates (Phadke, Quality Engineering Using Robust Design, 1989, chapter 5).
    """
    y = np.asarray(values, float)
    ratio: float | np.floating
    with np.errstate(divide="ignore", invalid="ignore"):
        if better == "larger":
            ratio = 1 / np.mean(1 / y**2)
        elif better == "smaller":
            ratio = 1 / np.mean(y**2)
        else:
            ratio = np.mean(y) ** 2 / np.var(y, ddof=1) if len(y) > 1 else np.nan
        decibel = 10 * np.log10(ratio)
    return float(decibel) if np.isfinite(decibel) else float("nan")


@dataclass(frozen=True, slots=True)
class LevelMeans:
    """Means of a response at the levels of one factor: a row of the response table."""

    factor: str
    levels: tuple[object, ...]
    means: tuple[float, ...]
    rank: int
    """1 has the largest delta."""

    @property
    def delta(self) -> float:
        """Largest less smallest mean."""
        return max(self.means) - min(self.means)


def response_table(levels: Mapping[str, Sequence[object]], response: ArrayLike) -> list[LevelMeans]:
    """Return the means of `response` by level; `levels` has, by factor, the level of each run."""
    values = np.asarray(response, float)
    means = {}
    for factor, of_runs in levels.items():
        found = np.asarray(of_runs)
        distinct = np.unique(found).tolist() if found.dtype.kind in "iuf" else list(dict.fromkeys(of_runs))
        means[factor] = (tuple(distinct), tuple(float(values[found == level].mean()) for level in distinct))
    spread = {factor: max(m) - min(m) for factor, (_, m) in means.items()}
    order = sorted(spread, key=lambda factor: -spread[factor])
    return [LevelMeans(factor, *means[factor], order.index(factor) + 1) for factor in levels]
