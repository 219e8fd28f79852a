"""Words of the image's controller by their names, for whoever looks in from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .controller import Stm32Controller

MEMBERS = (
    "tick",
    "boot_tick",
    "state",
    "armed",
    "keeps.fault",
    "keeps.boot_count",
    "box.frozen",
    "box.frozen_tick",
    "settings.watchdog_ticks",
    "parameters.crc",
    "motion.mode",
    "gap.tick",
    "gap.pulse_no",
    "motion.command_v",
    "gap.displacement_um",
    "gap.gap_v",
    "receiver.bad",
    "link.drop",
    "link.frames",
    "arms",
    "touch_offs",
    "readings",
    "size",
    "keeps.event_no",
    "telemetry.counter",
    "telemetry.pulse_counter",
)
"""What the image tells of its controller, `edm_layout` (board/stm32f4/image.c), in its order."""


class Seen:
    """Words of the image's memory by their names, for whoever looks in from outside."""

    def __init__(self, controller: Stm32Controller) -> None:
        self._c = controller

    @property
    def tick_counts(self) -> int:
        """Pulses of the last millisecond, packed by class."""
        four = self._c.bytes_of("gap.tick", 8).view("<u2").tolist()
        return sum(n << (12 * k) for k, n in enumerate(four))

    @property
    def command_v(self) -> float:
        """Voltage commanded of the actuator."""
        return float(self._c.bytes_of("motion.command_v", 4).view("<f4")[0])

    @property
    def watchdog_ticks(self) -> int:
        """Milliseconds of the host's silence that the board bears."""
        return self._c.word("settings.watchdog_ticks")

    @property
    def frozen_tick(self) -> int | None:
        """When a fault froze the black box; None while it goes on."""
        if not self._c.bytes_of("box.frozen", 1)[0]:
            return None
        return int(self._c.bytes_of("box.frozen_tick", 8).view("<i8")[0]) + self._c.ticks_before
