"""Gap voltage and gap current sample by sample, drawn from what is known of each pulse.

The kernel knows a pulse by its ignition delay, discharge time and plateau. What an oscilloscope would show of it is
put together here: the open voltage comes up through the series resistor, breaks down to the plateau, and falls when
the generator's switch opens. All time constants are assumed; docs/virtual-machine.md lists them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from collections.abc import Iterator

Floats: TypeAlias = NDArray[np.float64]

SAMPLE_NS = 1000
RISE_US = 0.5  # of the open voltage: series resistor and capacitance of gap and leads [assumed]
BREAKDOWN_US = 0.1  # of the voltage at ignition [assumed]
CURRENT_US = 0.3  # of the current, both ways: inductance of the leads [assumed]
DECAY_US = 2.0  # of the voltage once the switch is open [assumed]
SWITCH_OFF_US = 5.0  # from a fault until the switch is open; the protocol asks for 10
PLATEAU_NOISE = 0.025  # rms over plateau voltage [assumed]
VOLTAGE_NOISE_V, CURRENT_NOISE_A = 0.05, 0.0005  # rms of the converters [assumed]


@dataclass(frozen=True, slots=True)
class RecentPulses:
    """Pulses before a fault, oldest first, as rows of the kernel's ring, and how the generator was set.

    `fault_ns` counts from the setting up of the machine, as the starts of the pulses do.
    """

    rows: Floats
    fault_ns: int
    period_ns: int
    open_v: float
    on_time_us: float


def gap_signals(
    pulses: RecentPulses, begin_ns: int, samples: int, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """Voltage [V] and current [A] at `samples` instants, SAMPLE_NS apart, from `begin_ns` on."""
    v, a = np.zeros(samples), np.zeros(samples)
    lively = np.full(samples, VOLTAGE_NOISE_V)
    noise = random.standard_normal((2, samples))
    for row, first, end in _stretches(pulses, begin_ns, samples):
        start_us = (row[k.PULSE_START] - begin_ns) * 1e-3
        t_us = np.arange(first, end) * (SAMPLE_NS * 1e-3) - start_us
        safe_us = (pulses.fault_ns - row[k.PULSE_START]) * 1e-3 + SWITCH_OFF_US
        opens_us = min(pulses.on_time_us, row[k.PULSE_DELAY] + row[k.PULSE_DISCHARGE], safe_us)
        here = slice(first, end)
        v[here], a[here] = _one_pulse(row, t_us, pulses.open_v, opens_us)
        burns = (t_us >= row[k.PULSE_DELAY]) & (t_us < opens_us)
        lively[here][burns] += PLATEAU_NOISE * row[k.PULSE_PLATEAU]
        if row[k.PULSE_DISCHARGE] > 0.0:
            leaks = (t_us >= opens_us) & (t_us < min(pulses.period_ns * 1e-3, safe_us))
            a[here][leaks] += row[k.PULSE_LEAK]
    v += lively * noise[0]
    for row, first, end in _stretches(pulses, begin_ns, samples):
        if row[k.PULSE_STUCK] >= 0.0:
            v[first:end] = row[k.PULSE_STUCK]
    return v, a + CURRENT_NOISE_A * noise[1]


def _stretches(pulses: RecentPulses, begin_ns: int, samples: int) -> Iterator[tuple[Floats, int, int]]:
    """Each pulse with its first sample and the one behind its last: it lasts until the next one begins."""
    firsts = np.ceil((pulses.rows[:, k.PULSE_START] - begin_ns) / SAMPLE_NS).astype(np.int64)
    ends = np.append(firsts[1:], samples)
    for row, first, end in zip(pulses.rows, firsts.tolist(), ends.tolist(), strict=True):
        if end > max(first, 0):
            yield row, max(first, 0), end


def _one_pulse(row: Floats, t_us: Floats, open_v: float, opens_us: float) -> tuple[Floats, Floats]:
    """Voltage and current of a pulse at times since its begin; its switch is open from `opens_us` on."""
    delay_us = min(float(row[k.PULSE_DELAY]), opens_us)
    burning_us = opens_us - delay_us
    plateau_v = row[k.PULSE_PLATEAU]
    current_a = (open_v - plateau_v) * row[k.PULSE_SIEMENS]
    lit_v = open_v * -np.expm1(-delay_us / RISE_US)
    last_v, last_a = lit_v, 0.0
    if burning_us > 0.0:
        last_v = plateau_v + (lit_v - plateau_v) * np.exp(-burning_us / BREAKDOWN_US)
        last_a = current_a * -np.expm1(-burning_us / CURRENT_US)
    lit_t_us, off_t_us = np.maximum(t_us - delay_us, 0.0), np.maximum(t_us - opens_us, 0.0)
    parts = [t_us < delay_us, t_us < opens_us]
    v = np.select(
        parts,
        [
            open_v * -np.expm1(-t_us / RISE_US),
            plateau_v + (lit_v - plateau_v) * np.exp(-lit_t_us / BREAKDOWN_US),
        ],
        last_v * np.exp(-off_t_us / DECAY_US),
    )
    a = np.select(
        parts,
        [np.zeros(len(t_us)), current_a * -np.expm1(-lit_t_us / CURRENT_US)],
        last_a * np.exp(-off_t_us / CURRENT_US),
    )
    return v, a
