"""Whether the first measured cut can be that of this recipe: wrong polarity and wrong material show in the wear."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.machine.interface import host_fault
from edmctl.procedures.event_codes import RunEvent
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.run import Run
    from edmctl.process.wear import DepthAndWear

LARGEST_FACTOR = 3.0
"""Of the wear ratio that the recipe expects; the other polarity wears the tool several times as fast."""
LEAST_EXPECTED = 0.02
"""A recipe that expects less wear than this is taken to expect this: no tool keeps its length altogether."""


def refuse_wrong_setup(run: Run, found: DepthAndWear) -> None:
    """Raise MachineFault E67005 where the first cut wore the tool far too fast, or left a hill and no hole.

    Only what is beyond the uncertainty of the measurement counts.
    """
    expected = max(run.profile.wear.expected_ratio, LEAST_EXPECTED)
    least_wear_um = found.wear_um - found.wear_u95_um
    most_depth_um = found.depth_um + found.depth_u95_um
    if most_depth_um >= 0.0 and least_wear_um <= LARGEST_FACTOR * expected * most_depth_um:
        return
    error = host_fault(
        "SETUP",
        f" The first cut has a depth of {found.depth_um:.2f} µm and a wear of {found.wear_um:.2f} µm; "
        f"{expected:g} µm per µm were expected.",
    )
    args = {"depth_um": found.depth_um, "wear_um": found.wear_um, "expected_ratio": expected}
    run.decide(RunEvent.SETUP_WRONG, error.message, args, level=EventLevel.ERROR)
    raise error
