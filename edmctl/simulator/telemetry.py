"""Telemetry of the virtual controller: the kernel's packed records cut into frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from edmctl.link.messages import PulseBlocks, PulseLog, Pulses, Tlm, TlmStart
from edmctl.link.wire import Message
from edmctl.simulator.controller_state import LoopState, Settings
from edmctl.simulator.plant_interface import TICK_NS, Readings
from edmctl.simulator.records import rows

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

    def __init__(
        self,
        settings: Settings,
        loop: LoopState,
        readings: Readings,
        send: Callable[[Message], None],
        run: Callable[[int], int],
    ) -> None:
        self._settings, self._loop, self._readings = settings, loop, readings
        self._send, self._run = send, run
        self.samples = rows(Tlm.record_dtype(), 2 * SLICE_TICKS)
        records = SLICE_TICKS * PULSES_PER_TICK + PULSES_PER_FRAME
        self.blocks = rows(PulseBlocks.record_dtype(), records)
        self.pulses = rows(Pulses.record_dtype(), records)
        self._batch = 1
        self._full = False
        self._per_frame = BLOCKS_PER_FRAME
        self._tlm_counter = 0
        self._pulse_counter = 0
        self._start_tick = 0
        self.lost = self.frozen = False
        self._sent_us = 0
        loop.tlm_next = -1

    def start(self, request: TlmStart) -> None:
        """Begin a telemetry stream; the period counts from controller time zero."""
        loop, settings = self._loop, self._settings
        ticks = request.period_us // 1000
        settings.tlm_ticks = ticks
        since = self._readings.tick - self._start_tick
        loop.tlm_next = self._start_tick + (since // ticks + 1) * ticks
        self._drop_pending()
        loop.sample_counts = 0
        loop.charge_uc = 0.0
        loop.contact = 0
        settings.pulse_log = request.pulse_log
        self._batch = request.batch
        self._full = request.pulse_log == PulseLog.FULL
        self._per_frame = PULSES_PER_FRAME if self._full else BLOCKS_PER_FRAME

    def forget(self) -> None:
        """Stop at once; what is pending is lost."""
        self._loop.tlm_next = -1
        self._settings.pulse_log = PulseLog.OFF
        self._drop_pending()

    def _drop_pending(self) -> None:
        loop = self._loop
        loop.tlm_n = loop.log_n = loop.block_count = loop.block_counts = 0
        loop.delay_sum_us = loop.energy_sum_uj = 0.0

    def restart(self) -> None:
        """Stop at once and count frames and time from zero, as after a reset."""
        self.forget()
        self.count_from(self._readings.tick, frames=0)

    def count_from(self, start_tick: int, frames: int) -> None:
        """Count time from `start_tick`, and frames of either kind from `frames`."""
        self._start_tick = start_tick
        self._tlm_counter = self._pulse_counter = frames

    def stop(self) -> None:
        """Send what is pending, then stop."""
        self.flush()
        self._loop.tlm_next = -1
        self._settings.pulse_log = PulseLog.OFF

    def send_full_frames(self) -> None:
        """Send every frame that is full."""
        samples, records = self._loop.tlm_n, self._loop.log_n
        if samples >= self._batch:
            self._send_samples(samples, samples // self._batch * self._batch)
        if records >= self._per_frame:
            self._send_pulses(records, records // self._per_frame * self._per_frame)

    def flush(self) -> None:
        """Send everything pending, the begun pulse block included."""
        loop = self._loop
        if samples := loop.tlm_n:
            self._send_samples(samples, samples)
        if loop.block_count:
            self._run(0)
        if records := loop.log_n:
            self._send_pulses(records, records)

    def _send_samples(self, pending: int, count: int) -> None:
        period, batch = self._settings.tlm_ticks, self._batch
        last_tick = self._loop.tlm_next - period - self._start_tick
        first_us = (last_tick - (pending - 1) * period) * 1000
        data = self.samples[:count].tobytes()
        for start in range(0, count, batch):
            n = min(batch, count - start)
            t0_us = (first_us + start * period * 1000) & 0xFFFFFFFF
            records = data[start * SAMPLE_BYTES : (start + n) * SAMPLE_BYTES]
            if not self.frozen:
                self._sent_us = t0_us
            if not self.lost:
                self._send(Tlm(self._tlm_counter, self._sent_us, period * 1000, n, 0, records))
            self._tlm_counter = (self._tlm_counter + 1) & 0xFFFF
        self._loop.tlm_n = _keep(self.samples, count, pending)

    def _send_pulses(self, pending: int, count: int) -> None:
        loop = self._loop
        buffer, size = (self.pulses, PULSE_BYTES) if self._full else (self.blocks, BLOCK_BYTES)
        data = buffer[:count].tobytes()
        period_ns, block = self._settings.pulse_period_ns, self._settings.block_size
        step = 1 if self._full else block
        number, t0_ns = loop.log_pulse_no, loop.log_t0_ns - self._start_tick * TICK_NS
        for start in range(0, count, self._per_frame):
            n = min(self._per_frame, count - start)
            records = data[start * size : (start + n) * size]
            header = (self._pulse_counter, number & 0xFFFFFFFF, t0_ns // 1000 & 0xFFFFFFFF, period_ns)
            self._pulse_counter = (self._pulse_counter + 1) & 0xFFFF
            self._send(Pulses(*header, n, records) if self._full else PulseBlocks(*header, block, n, records))
            number += n * step
            t0_ns += n * step * period_ns
        loop.log_n = _keep(buffer, count, pending)
        loop.log_pulse_no, loop.log_t0_ns = number, t0_ns + self._start_tick * TICK_NS


def _keep(buffer: NDArray[np.void], sent: int, pending: int) -> int:
    """Move what is not sent to the front; how many records that is."""
    rest = pending - sent
    if rest:
        # As bytes: numpy moves records field by field.
        data, size = buffer.view(np.uint8).data, buffer.itemsize
        data[: rest * size] = data[sent * size : pending * size]
    return rest
