"""Pulses struck in a gap that a test holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmctl.core.library import library
from edmctl.link.messages import PulseClass
from edmctl.simulator.plant import Plant

PULSE = np.dtype([("pulse_class", "u1"), ("delay_us", "f8"), ("discharge_us", "f8"), ("plateau_v", "f8")])


def strike(plant: Plant) -> tuple[float, NDArray[np.void]]:
    """Strike the pulses of this millisecond: the sum of their mean voltages, and a record of each, dtype PULSE."""
    plant.random.provide(plant.state, 64, 1)
    library().strike_pulses(plant.in_c().place)
    unit, readings = plant.unit, plant.readings
    pulses = np.zeros(readings.pulses, PULSE)
    for name in ("delay_us", "discharge_us", "plateau_v"):
        pulses[name] = readings.array(name)[: readings.pulses]
    plateau_v = pulses["plateau_v"]
    pulses["pulse_class"] = np.select(
        [pulses["discharge_us"] == 0.0, plateau_v == unit.short_plateau_v, plateau_v == unit.arc_plateau_v],
        [PulseClass.OPEN, PulseClass.SHORT, PulseClass.ARC],
        PulseClass.NORMAL,
    )
    return readings.gap_v * readings.pulses, pulses
