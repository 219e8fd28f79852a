"""Random numbers for the kernel, so that results depend on the seed and on nothing else."""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.simulator.discharge import TABLE

if TYPE_CHECKING:
    from edmctl.simulator.plant_state import PlantState

Floats = NDArray[np.float64]

BLOCK = 32768


class RandomBlocks:
    """Random numbers in blocks, one stream a quantity, so that results do not depend on where blocks end."""

    def __init__(self, seed: np.random.SeedSequence, scatter: float) -> None:
        streams = [np.random.Generator(np.random.SFC64(s)) for s in seed.spawn(4)]
        self._decide, self._shape, self._delay, self._noise = streams
        self.pulse = np.empty((3, BLOCK))
        self.noise = np.empty(BLOCK)
        self.tables = _tables(scatter)
        self._fill_pulse(0)
        self._fill_noise(0)

    def _fill_pulse(self, start: int) -> None:
        self._decide.random(out=self.pulse[0, start:])
        self._shape.random(out=self.pulse[1, start:])
        self._delay.standard_exponential(out=self.pulse[2, start:])

    def _fill_noise(self, start: int) -> None:
        self._noise.standard_normal(out=self.noise[start:])

    def provide(self, state: PlantState, pulses: int, noises: int) -> None:
        """Make sure that so many numbers lie ahead of the places up to which they are used."""
        at = state.random_at
        if at + pulses > BLOCK:
            rest = BLOCK - at
            self.pulse[:, :rest] = self.pulse[:, at:].copy()
            self._fill_pulse(rest)
            state.random_at = 0
        at = state.noise_at
        if at + noises > BLOCK:
            rest = BLOCK - at
            self.noise[:rest] = self.noise[at:].copy()
            self._fill_noise(rest)
            state.noise_at = 0


def _tables(scatter: float) -> Floats:
    """Equally likely values of |N(0, 1)| and of a lognormal of mean one: the middles of TABLE equal steps."""
    normal = NormalDist()
    steps = (np.arange(TABLE) + 0.5) / TABLE
    half = np.array([normal.inv_cdf(0.5 + 0.5 * p) for p in steps])
    volume = np.exp([scatter * normal.inv_cdf(p) for p in steps])
    return np.stack([half, volume / volume.mean()])
