"""How a machine is wired to its controller: a switch reaches its input, another one, none, or the wrong way.

Mistakes of analog wires and of the contact are in `Unit`, which the plant reads.
"""

from __future__ import annotations

from typing import NamedTuple

from edmctl.dataclasses import dataclass

STAGE_X, STAGE_Y = 0, 1


class Inputs(NamedTuple):
    """Switches and slow sensors, as a controller reads them."""

    estop: bool
    door_open: bool
    hv_supply_ok: bool
    level_ok: bool
    limit_switch: bool
    flow_lpm: float
    temperature_c: float
    monitor_v: float


@dataclass(slots=True)
class Wiring:
    """What is wired wrongly; nothing at first."""

    estop_door_swapped: bool = False
    estop_open: bool = False  # its wire is off: pressed, whatever the button does
    door_bridged: bool = False
    level_inverted: bool = False
    supply_bridged: bool = False  # "high voltage ok" is tied to ok
    flow_open: bool = False
    x_share: float = 1.0  # way of the X stage over the way asked for: reversed -1, 0 without steps
    xy_swapped: bool = False

    def seen(self, real: Inputs) -> Inputs:
        """Return what reaches the controller of what is really so."""
        estop, door_open = real.estop, real.door_open
        if self.estop_door_swapped:
            estop, door_open = door_open, estop
        return Inputs(
            estop or self.estop_open,
            door_open and not self.door_bridged,
            real.hv_supply_ok or self.supply_bridged,
            real.level_ok != self.level_inverted,
            real.limit_switch,
            0.0 if self.flow_open else real.flow_lpm,
            real.temperature_c,
            real.monitor_v,
        )

    def drives(self, axis: int) -> tuple[int, float]:
        """Return which stage the steps of an axis move, and by what share of the way."""
        if axis not in (STAGE_X, STAGE_Y):
            return axis, 1.0
        share = self.x_share if axis == STAGE_X else 1.0
        return (STAGE_X + STAGE_Y - axis if self.xy_swapped else axis), share
