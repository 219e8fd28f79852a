"""One step after another of the electromechanical model: oscillator, charge and slip in one equation.

Compiled by numba, without fastmath: the source is the definition. SI units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from edmctl.actuator.compiling import cached
from edmctl.actuator.stops import change_for, move

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]


@cached
def advance_transducer(
    u_v: Array,
    pushes_n: Array,
    propagator: Array,
    transformer: float,
    capacitance: float,
    remainder: float,
    elastance: Array,
    limits: Array,
    motion: Array,
    stops: Array,
    positions: Array,
    charges: Array,
    transducer_v: Array,
) -> None:
    """Advance over voltages and forces on the stacks (k,); the last three (k,) receive what comes of it.

    propagator : (2, 4), position and speed from position, speed, force before and force after.
    remainder, elastance (n,), limits (n,) : 1/C_r, 1/C_i and C_i·v_i of the block H.
    motion : (4,), position, speed, force on the oscillator and charge; advances, as do the stops (n,).
    """
    position, speed, force, charge = motion
    drive = transformer / capacitance
    base = (1.0 - transformer * propagator[0, 3] * drive) / capacitance + remainder
    for k in range(u_v.shape[0]):
        coasting = propagator[0, 0] * position + propagator[0, 1] * speed + propagator[0, 2] * force
        reached = coasting + propagator[0, 3] * (drive * charge - pushes_n[k])
        load = (charge - transformer * reached) / capacitance + remainder * charge
        for i in range(limits.shape[0]):
            load += elastance[i] * stops[i]
        change = change_for(base, elastance, limits, stops, u_v[k] - load)
        move(limits, stops, change)
        charge += change
        after = drive * charge - pushes_n[k]
        speed = (
            propagator[1, 0] * position
            + propagator[1, 1] * speed
            + propagator[1, 2] * force
            + propagator[1, 3] * after
        )
        position = coasting + propagator[0, 3] * after
        force = after
        positions[k] = position
        charges[k] = charge
        transducer_v[k] = (charge - transformer * position) / capacitance
    motion[0], motion[1], motion[2], motion[3] = position, speed, force, charge
