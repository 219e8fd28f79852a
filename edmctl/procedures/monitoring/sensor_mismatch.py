"""Sensor against actuator model: a sensor that drifts, slips or loses its cable shows in their difference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.forecasts.forecast import stroke_um
from edmctl.machine.interface import host_fault
from edmctl.procedures.event_codes import RunEvent
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edmctl.machine.interface import TelemetryBlock
    from edmctl.procedures.run import Run

    Floats = NDArray[np.float64]

LARGEST_SHARE = 0.15
"""Of the stroke that the job uses: the bound of Muralidhara et al. 2009 for a model of hysteresis."""
PATIENCE_S = 2.0
"""A difference that lasts so long ends the job; a jolt or a jump is over sooner."""


class MismatchWatch:
    """Compares every block of samples with its estimates; warns at once, and raises when it lasts.

    It raises once: what comes after is the retreat, which nothing may disturb.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._largest_um = LARGEST_SHARE * stroke_um(run.profile)
        self._since_s: float | None = None
        self._over = False

    def take(self, block: TelemetryBlock, model_um: Floats) -> None:
        """Judge samples and their estimates, shape (n,) in µm. Raises MachineFault E67001."""
        sensor_um, estimate_um = float(block.displacement_um.mean()), float(model_um.mean())
        now_s = float(block.time_s[-1])
        if self._over or abs(sensor_um - estimate_um) <= self._largest_um:
            self._since_s = None
            return
        told = (
            f" The sensor shows {sensor_um:.1f} µm and the model {estimate_um:.1f} µm; {self._largest_um:.1f} µm "
            "apart is the most."
        )
        if self._since_s is None:
            self._since_s = float(block.time_s[0])
            self._run.decide(
                RunEvent.Z_MISMATCH,
                host_fault("Z_MISMATCH").message + told,
                {"sensor_um": sensor_um, "model_um": estimate_um, "limit_um": self._largest_um},
                level=EventLevel.WARNING,
            )
        elif now_s - self._since_s >= PATIENCE_S:
            self._over = True
            raise host_fault("Z_MISMATCH", told)
