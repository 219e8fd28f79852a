"""What a fault freezes of the gap: the waveforms of the pulses about it.

The plant knows a pulse by its ignition delay, discharge time and plateau; firmware/plant/pulse_shape.c makes the
waveform of it that an oscilloscope would show. The black box is in the core (firmware/core/blackbox.c).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass
from edmctl.link.messages import WaveformReadReply
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import TICK_NS

PLATEAU_NOISE = 0.025  # rms over plateau voltage [assumed]
VOLTAGE_NOISE_V, CURRENT_NOISE_A = 0.05, 0.0005  # rms of the converters [assumed]
PULSES_BEFORE, PERIODS_AFTER = 64, 16
MOST_SAMPLES = 65536
SHARE_AFTER = 5
"""A fifth of the memory is for the time after a fault."""
WAVEFORM_PER_REPLY = 58
_LONG_AGO_NS = -1e18
_RECORD = WaveformReadReply.record_dtype()
_PER_COUNT = 0.01, 0.001  # V and A
PULSE_COLUMNS = ("start_ns", "delay_us", "discharge_us", "plateau_v", "siemens", "leak_a", "stuck_v")
PULSE = np.dtype([(name, np.float64) for name in PULSE_COLUMNS])
"""A pulse of `Scope`."""

SAMPLE_NS = 1000
SWITCH_OFF_US = 5.0  # from a fault until the switch is open; the protocol asks for 10


@dataclass(frozen=True, slots=True)
class RecentPulses:
    """Pulses before a fault, oldest first, as `PULSE`s, and how the generator was set.

    `fault_ns` counts from the setting up of the machine, as the starts of the pulses do.
    """

    rows: NDArray[np.void]
    fault_ns: int
    period_ns: int
    open_v: float
    on_time_us: float


def gap_signals(
    pulses: RecentPulses, begin_ns: int, samples: int, random: np.random.Generator
) -> tuple[Array, Array]:
    """Voltage [V] and current [A] at `samples` instants, SAMPLE_NS apart, from `begin_ns` on."""
    v, a = np.zeros(samples), np.zeros(samples)
    lively = np.full(samples, VOLTAGE_NOISE_V)
    noise = random.standard_normal((2, samples))
    for row, first, end in _stretches(pulses, begin_ns, samples):
        start_us = (row["start_ns"] - begin_ns) * 1e-3
        t_us = np.arange(first, end) * (SAMPLE_NS * 1e-3) - start_us
        safe_us = (pulses.fault_ns - row["start_ns"]) * 1e-3 + SWITCH_OFF_US
        opens_us = min(pulses.on_time_us, row["delay_us"] + row["discharge_us"], safe_us)
        here = slice(first, end)
        delay_us, plateau_v, siemens = (float(row[name]) for name in ("delay_us", "plateau_v", "siemens"))
        v[here], a[here] = pulse_signals(
            t_us, pulses.open_v, min(delay_us, opens_us), opens_us, plateau_v, siemens
        )
        burns = (t_us >= row["delay_us"]) & (t_us < opens_us)
        lively[here][burns] += PLATEAU_NOISE * row["plateau_v"]
        if row["discharge_us"] > 0.0:
            leaks = (t_us >= opens_us) & (t_us < min(pulses.period_ns * 1e-3, safe_us))
            a[here][leaks] += row["leak_a"]
    v += lively * noise[0]
    for row, first, end in _stretches(pulses, begin_ns, samples):
        if row["stuck_v"] >= 0.0:
            v[first:end] = row["stuck_v"]
    return v, a + CURRENT_NOISE_A * noise[1]


def pulse_signals(
    t_us: Array, open_v: float, delay_us: float, opens_us: float, plateau_v: float, siemens: float
) -> tuple[Array, Array]:
    """Return voltage, V, and current, A, of a pulse at times since its begin, shape (n,) as `t_us`.

    The open voltage rises through the series resistor, breaks down to the plateau `delay_us` after the begin, and
    falls when the generator's switch opens at `opens_us`; without ignition both are equal. The law and its
    constants: firmware/plant/pulse_shape.c.
    """
    t_us = np.ascontiguousarray(t_us)
    v, a = np.empty_like(t_us), np.empty_like(t_us)
    library().pulse_signals(
        len(t_us),
        t_us.ctypes.data,
        open_v,
        delay_us,
        opens_us,
        plateau_v,
        siemens,
        v.ctypes.data,
        a.ctypes.data,
    )
    return v, a


def _stretches(pulses: RecentPulses, begin_ns: int, samples: int) -> Iterator[tuple[np.void, int, int]]:
    """Each pulse with its first sample and the one behind its last: it lasts until the next one begins."""
    firsts = np.ceil((pulses.rows["start_ns"] - begin_ns) / SAMPLE_NS).astype(np.int64)
    ends = np.append(firsts[1:], samples)
    for row, first, end in zip(pulses.rows, firsts.tolist(), ends.tolist(), strict=True):
        if end > max(first, 0):
            yield row, max(first, 0), end


class Waveforms:
    """What a fault froze of the newest pulses, which the plant keeps.

    frozen : the pulses about the fault, None without one. boot_ns : when the controller started that saw it.
    memory : samples that there is room for; boards have less.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.frozen: RecentPulses | None = None
        self.boot_ns = 0
        self.memory = MOST_SAMPLES
        self._records = b""
        self.forget()

    def forget(self) -> None:
        """Begin anew, as after a reset or with another setting of the generator; what is frozen stays."""
        self._plant.scope.array("start_ns")[:] = _LONG_AGO_NS

    def freeze(self, now: int, start: int) -> None:
        """Keep the pulses up to tick `now` of a controller started at tick `start`; what is kept stays."""
        if self.frozen is not None:
            return
        plant, fault_ns = self._plant, now * TICK_NS
        period_ns = plant.unit.pulse_period_ns
        oldest_ns = fault_ns - min(
            PULSES_BEFORE * period_ns, (self.memory - self.memory // SHARE_AFTER) * SAMPLE_NS
        )
        ring = np.rec.fromarrays([plant.scope.array(name) for name in PULSE_COLUMNS], PULSE)
        rows = ring[ring["start_ns"].argsort(kind="stable")]
        rows = rows[rows["start_ns"] >= oldest_ns]
        self.frozen = RecentPulses(rows, fault_ns, period_ns, plant.unit.open_v, plant.unit.on_time_us)
        self.boot_ns = start * TICK_NS
        self._records = b""

    def thaw(self) -> None:
        """Let the memory go on."""
        self.frozen = None
        self._records = b""

    def read(self, offset: int, now: int) -> WaveformReadReply | None:
        """Part of what is held, from sample `offset` on; None while the time after the fault still runs."""
        pulses = self.frozen
        if pulses is None or len(pulses.rows) == 0:
            return WaveformReadReply(0, 0, SAMPLE_NS, 0, b"")
        begin_ns, end_ns = self.window_ns(pulses)
        if now * TICK_NS < end_ns:
            return None
        total = (end_ns - begin_ns) // SAMPLE_NS
        if not self._records:
            self._records = self._drawn(pulses, begin_ns, total)
        n = max(0, min(WAVEFORM_PER_REPLY, total - offset))
        records = self._records[offset * _RECORD.itemsize : (offset + n) * _RECORD.itemsize]
        t0_us = (begin_ns - self.boot_ns) // 1000 & 0xFFFFFFFF
        return WaveformReadReply(total, t0_us, SAMPLE_NS, n, records)

    def window_ns(self, pulses: RecentPulses) -> tuple[int, int]:
        """From when to when samples are held of these pulses."""
        begin_ns = int(pulses.rows["start_ns"][0]) // SAMPLE_NS * SAMPLE_NS
        return begin_ns, pulses.fault_ns + min(
            PERIODS_AFTER * pulses.period_ns, self.memory // SHARE_AFTER * SAMPLE_NS
        )

    def _drawn(self, pulses: RecentPulses, begin_ns: int, total: int) -> bytes:
        """Every sample as the wire carries it. The noise is the machine's and the moment's own."""
        random = np.random.default_rng([*self._plant.serial.encode(), pulses.fault_ns // TICK_NS])
        signals = gap_signals(pulses, begin_ns, total, random)
        records, limits = np.zeros(total, dtype=_RECORD), np.iinfo(np.int16)
        for name, values, per_count in zip(("gap_v", "current_a"), signals, _PER_COUNT, strict=True):
            records[name] = np.clip(np.rint(values / per_count), limits.min, limits.max)
        return records.tobytes()
