"""Telemetry of the virtual controller: the kernel's packed records cut into frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.link.messages import PulseBlocks, PulseLog, Pulses, Tlm, TlmStart
from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.wire import Message
    from edmctl.simulator.plant import Plant

SAMPLE_BYTES, BLOCK_BYTES, PULSE_BYTES = 16, 12, 6
BLOCKS_PER_FRAME, PULSES_PER_FRAME = 19, 38
SLICE_TICKS = 200  # the kernel's longest run; sizes the buffers
PULSES_PER_TICK = 52  # at the highest frequency of a profile, 50 kHz


class Telemetry:
    """Owns the kernel's three output buffers and sends what is in them."""

    def __init__(self, plant: Plant, send: Callable[[Message], None]) -> None:
        self._plant, self._send = plant, send
        self.samples = np.zeros(SAMPLE_BYTES * 2 * SLICE_TICKS, dtype=np.uint8)
        records = SLICE_TICKS * PULSES_PER_TICK + PULSES_PER_FRAME
        self.blocks = np.zeros(BLOCK_BYTES * records, dtype=np.uint8)
        self.pulses = np.zeros(PULSE_BYTES * records, dtype=np.uint8)
        self._batch = 1
        self._tlm_counter = 0
        self._pulse_counter = 0

    def start(self, request: TlmStart) -> None:
        """Begin a telemetry stream; the period counts from controller time zero."""
        ist = self._plant.ist
        ist[k.TLM_TICKS] = request.period_us // 1000
        ist[k.TLM_N] = 0
        ist[k.SAMPLE_OPEN : k.SAMPLE_SHORT + 1] = 0
        self._plant.st[k.CHARGE] = 0.0
        ist[k.PULSE_LOG] = request.pulse_log
        ist[k.LOG_N] = ist[k.BLOCK_COUNT] = 0
        self._batch = request.batch

    def stop(self) -> None:
        """Send what is pending, then stop."""
        self.flush()
        self._plant.ist[k.TLM_TICKS] = 0
        self._plant.ist[k.PULSE_LOG] = PulseLog.OFF

    def send_full_frames(self) -> None:
        """Send every frame that is full."""
        ist = self._plant.ist
        if ist[k.TLM_N] >= self._batch:
            self._send_samples(int(ist[k.TLM_N]) // self._batch * self._batch)
        if ist[k.LOG_N]:
            self._send_pulses(everything=False)

    def flush(self) -> None:
        """Send everything pending, the begun pulse block included."""
        ist = self._plant.ist
        if ist[k.TLM_N]:
            self._send_samples(int(ist[k.TLM_N]))
        k.close_block(self._plant.st, ist, self.blocks)
        if ist[k.LOG_N]:
            self._send_pulses(everything=True)

    def _send_samples(self, count: int) -> None:
        ist = self._plant.ist
        period = int(ist[k.TLM_TICKS])
        pending = int(ist[k.TLM_N])
        last_tick = int(ist[k.TICK]) // period * period
        first_us = (last_tick - (pending - 1) * period) * 1000
        data = self.samples[: pending * SAMPLE_BYTES].tobytes()
        for start in range(0, count, self._batch):
            n = min(self._batch, count - start)
            t0_us = (first_us + start * period * 1000) & 0xFFFFFFFF
            records = data[start * SAMPLE_BYTES : (start + n) * SAMPLE_BYTES]
            self._send(Tlm(self._tlm_counter & 0xFFFF, t0_us, period * 1000, n, 0, records))
            self._tlm_counter += 1
        self._keep(self.samples, SAMPLE_BYTES, count, pending)
        ist[k.TLM_N] = pending - count

    def _send_pulses(self, *, everything: bool) -> None:
        ist = self._plant.ist
        full = ist[k.PULSE_LOG] == PulseLog.FULL
        buffer, size, per_frame = (
            (self.pulses, PULSE_BYTES, PULSES_PER_FRAME)
            if full
            else (self.blocks, BLOCK_BYTES, BLOCKS_PER_FRAME)
        )
        pending = int(ist[k.LOG_N])
        count = pending if everything else pending // per_frame * per_frame
        if count == 0:
            return
        data = buffer[: count * size].tobytes()
        period_ns, block = int(ist[k.PULSE_PERIOD]), int(ist[k.BLOCK_SIZE])
        step = 1 if full else block
        for start in range(0, count, per_frame):
            n = min(per_frame, count - start)
            records = data[start * size : (start + n) * size]
            number = (int(ist[k.LOG_PULSE_NO]) + start * step) & 0xFFFFFFFF
            t0_us = ((int(ist[k.LOG_T0]) + start * step * period_ns) // 1000) & 0xFFFFFFFF
            counter = self._pulse_counter & 0xFFFF
            self._pulse_counter += 1
            self._send(
                Pulses(counter, number, t0_us, period_ns, n, records)
                if full
                else PulseBlocks(counter, number, t0_us, period_ns, block, n, records)
            )
        self._keep(buffer, size, count, pending)
        ist[k.LOG_N] = pending - count
        ist[k.LOG_PULSE_NO] += count * step
        ist[k.LOG_T0] += count * step * period_ns

    @staticmethod
    def _keep(buffer: k.Bytes, size: int, sent: int, pending: int) -> None:
        rest = (pending - sent) * size
        if rest:
            buffer[:rest] = buffer[sent * size : sent * size + rest].copy()
