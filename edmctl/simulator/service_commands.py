"""Commands of the virtual controller that tell: schema, status, telemetry, what a fault froze; and its restart."""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.messages import Status
from edmctl.simulator.telemetry import bytes_per_second

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.simulator.controller import VirtualController
    from edmctl.simulator.port import Outcome

TLM_MAX_HZ = 1000
RATE_RESERVE = 0.25  # of a line, for replies and events
BITS_PER_BYTE = 10
SCHEMA_PER_REPLY = 243
REBOOT_MAGIC = 0x0B007EDB
OK: Outcome = (Status.OK, b"")


@cache
def compressed_schema() -> bytes:
    """The canonical schema, as GET_SCHEMA hands it out."""
    from edmctl.link.schema import load_schema

    return zlib.compress(load_schema().canonical_json().encode(), 9)


class ServiceCommands:
    """Answers questions; changes nothing that moves."""

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self.handlers: dict[type, Callable[..., Outcome]] = {
            m.GetSchema: self._get_schema,
            m.Advance: self._advance,
            m.GetStatus: self._get_status,
            m.BlackboxRead: self._black_box,
            m.WaveformRead: self._waveforms,
            m.Reboot: self._reboot,
            m.TlmStart: self._tlm_start,
            m.TlmStop: self._tlm_stop,
        }

    def _get_schema(self, request: m.GetSchema) -> Outcome:
        data = compressed_schema()
        part = data[request.offset : request.offset + SCHEMA_PER_REPLY]
        return Status.OK, m.GetSchemaReply(len(data), len(part), part).pack()

    def _advance(self, request: m.Advance) -> Outcome:
        if not self._c.port.driven:
            return Status.UNKNOWN_TYPE, b""
        if self._c.reset_asked:
            self._c.reset(m.ResetCause.COMMANDED)
        if request.timeout_us:
            self._c.host_wait.wait(request.timeout_us * 1e-6)
        return Status.OK, m.AdvanceReply(self._c.time_us).pack()

    def _get_status(self, _: m.GetStatus) -> Outcome:
        plant = self._c.plant
        reply = m.GetStatusReply(
            state=self._c.state,
            fault=self._c.fault,
            interlocks=self._c.guards.open_interlocks(),
            displacement_um=self._c.loop.displacement_um,
            x_um=plant.reported[m.Axis.X],
            y_um=plant.reported[m.Axis.Y],
            theta_deg=plant.reported[m.Axis.THETA],
            actuator_v=self._c.plant.drive.actuator_v,
            gap_v=self._c.loop.gap_v,
            temperature_c=plant.dielectric_temperature_c,
            flow_lpm=plant.dielectric_flow_lpm,
            monitor_v=plant.monitor_v(),
            flags=self._c.black_box.newest_flags(self._c.tick),
        )
        return Status.OK, reply.pack()

    def _black_box(self, request: m.BlackboxRead) -> Outcome:
        c = self._c
        return Status.OK, c.black_box.read(request.offset, c.tick, c.boot_tick).pack()

    def _waveforms(self, request: m.WaveformRead) -> Outcome:
        reply = self._c.waveforms.read(request.offset, self._c.tick)
        return (Status.BUSY, b"") if reply is None else (Status.OK, reply.pack())

    def _reboot(self, request: m.Reboot) -> Outcome:
        if self._c.armed:
            return Status.BAD_STATE, b""
        if request.magic != REBOOT_MAGIC:
            return Status.OUT_OF_RANGE, b""
        self._c.reset_asked = True  # the reply goes first
        return OK

    def _tlm_start(self, request: m.TlmStart) -> Outcome:
        if request.period_us * TLM_MAX_HZ < 1_000_000:
            return Status.RATE_TOO_HIGH, b""
        pulses = request.period_us * 1000 / self._c.settings.pulse_period_ns
        if request.period_us % 1000 or not 1 <= request.batch <= 14 or pulses > 255:
            return Status.OUT_OF_RANGE, b""
        needed = (1.0 + RATE_RESERVE) * bytes_per_second(
            request, self._c.settings.pulse_period_ns, self._c.settings.block_size
        )
        if self._c.baud and needed > self._c.baud / BITS_PER_BYTE:
            return Status.RATE_TOO_HIGH, b""
        self._c.telemetry.start(request)
        return OK

    def _tlm_stop(self, _: m.TlmStop) -> Outcome:
        self._c.telemetry.stop()
        return OK
