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
TLM_HEADER_BYTES, BLOCKS_HEADER_BYTES, PULSES_HEADER_BYTES = 10, 16, 15
SLICE_TICKS = 200  # the kernel's longest run; sizes the buffers
FRAME_BYTES = 11  # of every frame beside its payload: header, check, COBS, two zeros
PULSES_PER_TICK = 52  # at the highest frequency of a profile, 50 kHz


def bytes_per_second(request: TlmStart, pulse_period_ns: int, block_pulses: int) -> float:
    """Bytes per second on the line that a request asks for."""
    samples_s = 1e6 / request.period_us
    bytes_s = samples_s * (SAMPLE_BYTES + (FRAME_BYTES + TLM_HEADER_BYTES) / request.batch)
    pulses_s = 1e9 / pulse_period_ns
    if request.pulse_log == PulseLog.FULL:
        bytes_s += pulses_s * (PULSE_BYTES + (FRAME_BYTES + PULSES_HEADER_BYTES) / PULSES_PER_FRAME)
    elif request.pulse_log == PulseLog.BLOCKS:
        blocks_s = pulses_s / block_pulses
        bytes_s += blocks_s * (BLOCK_BYTES + (FRAME_BYTES + BLOCKS_HEADER_BYTES) / BLOCKS_PER_FRAME)
    return bytes_s


class Telemetry:
    """Owns the kernel's three output buffers and sends what is in them.

    `lost` is a line that carries everything but samples, `frozen` a controller whose samples all have the time of
    the last one before.
    """

    def __init__(self, plant: Plant, send: Callable[[Message], None], run: Callable[[int], int]) -> None:
        self._plant, self._send, self._run = plant, send, run
        self.samples = np.zeros(SAMPLE_BYTES * 2 * SLICE_TICKS, dtype=np.uint8)
        records = SLICE_TICKS * PULSES_PER_TICK + PULSES_PER_FRAME
        self.blocks = np.zeros(BLOCK_BYTES * records, dtype=np.uint8)
        self.pulses = np.zeros(PULSE_BYTES * records, dtype=np.uint8)
        self._batch = 1
        self._full = False
        self._per_frame = BLOCKS_PER_FRAME
        self._tlm_counter = 0
        self._pulse_counter = 0
        self._start_tick = 0
        self.lost = self.frozen = False
        self._sent_us = 0

    def start(self, request: TlmStart) -> None:
        """Begin a telemetry stream; the period counts from controller time zero."""
        ist = self._plant.ist
        ticks = request.period_us // 1000
        ist[k.TLM_TICKS] = ticks
        ist[k.TLM_NEXT] = self._start_tick + ((ist.item(k.TICK) - self._start_tick) // ticks + 1) * ticks
        ist[k.TLM_N] = 0
        ist[k.SAMPLE_COUNTS] = 0
        self._plant.st[k.CHARGE] = 0.0
        ist[k.PULSE_LOG] = request.pulse_log
        ist[k.LOG_N] = ist[k.BLOCK_COUNT] = 0
        self._batch = request.batch
        self._full = request.pulse_log == PulseLog.FULL
        self._per_frame = PULSES_PER_FRAME if self._full else BLOCKS_PER_FRAME

    def forget(self) -> None:
        """Stop at once; what is pending is lost."""
        ist = self._plant.ist
        ist[k.TLM_NEXT] = -1
        ist[k.PULSE_LOG] = PulseLog.OFF
        ist[k.TLM_N] = ist[k.LOG_N] = ist[k.BLOCK_COUNT] = 0
        ist[k.BLOCK_OPEN : k.BLOCK_SHORT + 1] = 0
        self._plant.st[k.DELAY_SUM] = self._plant.st[k.ENERGY_SUM] = 0.0

    def restart(self) -> None:
        """Stop at once and count frames and time from zero, as after a reset."""
        self.forget()
        self._tlm_counter = self._pulse_counter = 0
        self._start_tick = self._plant.ist.item(k.TICK)

    def stop(self) -> None:
        """Send what is pending, then stop."""
        self.flush()
        self._plant.ist[k.TLM_NEXT] = -1
        self._plant.ist[k.PULSE_LOG] = PulseLog.OFF

    def send_full_frames(self) -> None:
        """Send every frame that is full."""
        ist = self._plant.ist
        samples = ist.item(k.TLM_N)
        if samples >= self._batch:
            self._send_samples(samples, samples // self._batch * self._batch)
        records = ist.item(k.LOG_N)
        if records >= self._per_frame:
            self._send_pulses(records, records // self._per_frame * self._per_frame)

    def flush(self) -> None:
        """Send everything pending, the begun pulse block included."""
        ist = self._plant.ist
        if samples := ist.item(k.TLM_N):
            self._send_samples(samples, samples)
        if ist.item(k.BLOCK_COUNT):
            self._run(0)
        if records := ist.item(k.LOG_N):
            self._send_pulses(records, records)

    def _send_samples(self, pending: int, count: int) -> None:
        ist = self._plant.ist
        period, batch = ist.item(k.TLM_TICKS), self._batch
        last_tick = ist.item(k.TLM_NEXT) - period - self._start_tick
        first_us = (last_tick - (pending - 1) * period) * 1000
        data = self.samples[: count * SAMPLE_BYTES].tobytes()
        for start in range(0, count, batch):
            n = min(batch, count - start)
            t0_us = (first_us + start * period * 1000) & 0xFFFFFFFF
            records = data[start * SAMPLE_BYTES : (start + n) * SAMPLE_BYTES]
            if not self.frozen:
                self._sent_us = t0_us
            if not self.lost:
                self._send(Tlm(self._tlm_counter, self._sent_us, period * 1000, n, 0, records))
            self._tlm_counter = (self._tlm_counter + 1) & 0xFFFF
        self._keep(self.samples, SAMPLE_BYTES, count, pending)
        ist[k.TLM_N] = pending - count

    def _send_pulses(self, pending: int, count: int) -> None:
        ist = self._plant.ist
        buffer, size = (self.pulses, PULSE_BYTES) if self._full else (self.blocks, BLOCK_BYTES)
        data = buffer[: count * size].tobytes()
        period_ns, block = ist.item(k.PULSE_PERIOD), ist.item(k.BLOCK_SIZE)
        step = 1 if self._full else block
        number, t0_ns = ist.item(k.LOG_PULSE_NO), ist.item(k.LOG_T0) - self._start_tick * k.TICK_NS
        for start in range(0, count, self._per_frame):
            n = min(self._per_frame, count - start)
            records = data[start * size : (start + n) * size]
            header = (self._pulse_counter, number & 0xFFFFFFFF, t0_ns // 1000 & 0xFFFFFFFF, period_ns)
            self._pulse_counter = (self._pulse_counter + 1) & 0xFFFF
            self._send(Pulses(*header, n, records) if self._full else PulseBlocks(*header, block, n, records))
            number += n * step
            t0_ns += n * step * period_ns
        self._keep(buffer, size, count, pending)
        ist[k.LOG_N], ist[k.LOG_PULSE_NO], ist[k.LOG_T0] = (
            pending - count,
            number,
            t0_ns + self._start_tick * k.TICK_NS,
        )

    @staticmethod
    def _keep(buffer: k.Bytes, size: int, sent: int, pending: int) -> None:
        rest = (pending - sent) * size
        if rest:
            buffer[:rest] = buffer[sent * size : sent * size + rest].copy()
