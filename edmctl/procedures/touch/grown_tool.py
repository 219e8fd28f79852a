"""A tool that is longer than before cannot be: then a touch of the pad was wrong, or the tool has slipped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.errors import ObjectiveNotReached
from edmctl.procedures.touch.tool_length import TOUCH_U_UM
from edmctl.process.touch_check import Deviation, has_grown

if TYPE_CHECKING:
    from edmctl.procedures.run import Run
    from edmctl.procedures.touch.reading import SurfaceReading


def refuse_grown_tool(
    run: Run, z1_um: float, z3: SurfaceReading, age_s: float, more_u_um: float = 0.0
) -> None:
    """Raise ObjectiveNotReached E7023 where the pad says that the tool has become longer.

    `z1_um` is the pad `age_s` ago, with a standard uncertainty of `more_u_um` besides drift and touches.
    """
    drift_um = run.uncertainty.drift_u_um_per_s * age_s
    u_um = math.hypot(TOUCH_U_UM, TOUCH_U_UM, more_u_um, z3.doubt_u_um, drift_um)
    wear = Deviation(z3.z_um - z1_um, u_um)
    if not has_grown(wear):
        return
    raise ObjectiveNotReached(
        f"Z3 = {z3.z_um:.2f} µm: the tool is {-wear.um:.2f} µm longer than before the cut (standard uncertainty "
        f"{u_um:.2f} µm), which it cannot be.",
        hint="Clean the face of the tool and the reference pad, and look whether the tool has slipped in its chuck.",
        code="E7023",
    )
