"""The memory of gap waveforms: what the gap's voltage and current did about a fault."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.link.messages import WaveformReadReply
from edmctl.simulator import kernel as k
from edmctl.simulator.gap_signals import SAMPLE_NS, RecentPulses, gap_signals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.simulator.plant import Plant

PULSES_BEFORE, PERIODS_AFTER = 64, 16
MOST_SAMPLES = 65536
MOST_AFTER = MOST_SAMPLES // 5
PER_REPLY = 58
_LONG_AGO_NS = -1e18
_RECORD = WaveformReadReply.record_dtype()
_V_PER_COUNT, _A_PER_COUNT = 0.01, 0.001


class Waveforms:
    """The ring of the newest pulses, which the kernel writes, and what a fault froze of it.

    frozen : the pulses about the fault, None without one. boot_ns : when the controller started that saw it.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.ring = np.zeros((k.RECENT, k.RECENT_COLUMNS))
        self.frozen: RecentPulses | None = None
        self.boot_ns = 0
        self._records = b""
        self.forget()

    def forget(self) -> None:
        """Begin anew, as after a reset or with another setting of the generator; what is frozen stays."""
        self.ring[:, k.PULSE_START] = _LONG_AGO_NS

    def freeze(self, now: int, start: int) -> None:
        """Keep the pulses up to tick `now` of a controller started at tick `start`; what is kept stays."""
        if self.frozen is not None:
            return
        plant, fault_ns = self._plant, now * k.TICK_NS
        period_ns = plant.ist.item(k.PULSE_PERIOD)
        oldest_ns = fault_ns - min(PULSES_BEFORE * period_ns, (MOST_SAMPLES - MOST_AFTER) * SAMPLE_NS)
        rows = self.ring[self.ring[:, k.PULSE_START].argsort(kind="stable")]
        self.frozen = RecentPulses(
            rows=rows[rows[:, k.PULSE_START] >= oldest_ns],
            fault_ns=fault_ns,
            period_ns=period_ns,
            open_v=plant.par.item(k.OPEN_V),
            on_time_us=plant.par.item(k.ON_TIME),
        )
        self.boot_ns = start * k.TICK_NS
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
        end_ns = pulses.fault_ns + min(PERIODS_AFTER * pulses.period_ns, MOST_AFTER * SAMPLE_NS)
        if now * k.TICK_NS < end_ns:
            return None
        begin_ns = int(pulses.rows[0, k.PULSE_START]) // SAMPLE_NS * SAMPLE_NS
        total = (end_ns - begin_ns) // SAMPLE_NS
        if not self._records:
            self._records = self._drawn(pulses, begin_ns, total)
        n = max(0, min(PER_REPLY, total - offset))
        records = self._records[offset * _RECORD.itemsize : (offset + n) * _RECORD.itemsize]
        t0_us = (begin_ns - self.boot_ns) // 1000 & 0xFFFFFFFF
        return WaveformReadReply(total, t0_us, SAMPLE_NS, n, records)

    def _drawn(self, pulses: RecentPulses, begin_ns: int, total: int) -> bytes:
        """Every sample as the wire carries it. The noise is the machine's and the moment's own."""
        random = np.random.default_rng([*self._plant.serial.encode(), pulses.fault_ns // k.TICK_NS])
        v, a = gap_signals(pulses, begin_ns, total, random)
        records = np.zeros(total, dtype=_RECORD)
        records["gap_v"], records["current_a"] = _counts(v, _V_PER_COUNT), _counts(a, _A_PER_COUNT)
        return records.tobytes()


def _counts(values: NDArray[np.float64], per_count: float) -> NDArray[np.float64]:
    limits = np.iinfo(np.int16)
    return np.clip(np.rint(values / per_count), limits.min, limits.max)
