"""A jump as the controller is told it: the one place where its µm become those of the mean gain.

JUMP carries lengths, and the controller turns them into volts by `gain_um_per_v`, since it has no actuator model.
After a turning point the actuator moves far less per volt than that: 60 µm come out as 41. So the host asks its
model for the voltages of the jump wanted, and sends voltage × mean gain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.actuator.inverse import jump_volts
from edmctl.machine.interface import JumpRequest

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

CLEARANCE_UM = 1.0
"""A jump comes back fast to this far above the last spark point, with a working gap of some µm still below it. From
5 µm the servo took 0.3 s to find its gap again; the actuator comes back within 0.4 µm (decision 0021)."""


def jump_request(run: Run, height_um: float) -> JumpRequest:
    """Ask for a jump of `height_um` at the profile's speed; without an actuator model by the mean gain alone.

    The speed on the wire grows with the height on the wire, so that the jump takes the time that the profile says.
    """
    jump, gain_um_per_v = run.profile.jump, run.setup.actuator.gain_um_per_v
    estimator = run.watch.estimator()
    if estimator is None:
        return JumpRequest(height_um, jump.speed_um_s, jump.dwell_s, CLEARANCE_UM)
    volts = jump_volts(estimator, height_um, CLEARANCE_UM, height_um / jump.speed_um_s, jump.dwell_s)
    told_um = gain_um_per_v * volts.height_v
    return JumpRequest(
        height_um=told_um,
        speed_um_s=jump.speed_um_s * max(1.0, told_um / height_um),
        dwell_s=jump.dwell_s,
        clearance_um=gain_um_per_v * volts.clearance_v,
    )
