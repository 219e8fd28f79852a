"""Step and direction."""

from __future__ import annotations

from tools.generate.circuits.common import Check, Circuit, Needs


def stages(n: Needs) -> Circuit:
    """Step and direction."""
    steps, um, degrees = n.scale["EDM_MOST_STEPS_PER_MS"], n.scale["EDM_STEP_UM"], n.scale["EDM_STEP_DEGREES"]
    half_us = 1e3 / steps / 2
    return Circuit(
        "stages",
        (
            (
                "outputs",
                "74HCT buffer to 5 V, or RS-422 driver for drives that take differential inputs, the pull-downs at "
                "its inputs",
            ),
            ("drives", "an enable of their own, off while the chip is flashed"),
        ),
        (
            Check(
                "half a period at most steps", "> 2.5 µs, of common drives", f"{half_us:g} µs", half_us > 2.5
            ),
            Check("direction before the first step", "> 5 µs", "1 ms", True),
            Check(
                "greatest speed",
                "> 1 mm/s and 10 degrees/s, of the setup",
                f"{steps * um:g} mm/s, {steps * degrees * 1e3:g} degrees/s",
                steps * um > 1.0 and steps * degrees * 1e3 > 10.0,
            ),
        ),
    )
