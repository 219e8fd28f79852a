"""A touch against the samples of the same moment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.machine.reports import joined
from edmctl.machine.states import TelemetryFlag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.machine.orders import TouchRequest
    from edmctl.machine.reports import Floats, MachineEvent, TelemetryBlock

LEAST_SAMPLES = 3
"""Fewer samples of a dwell tell nothing of its mean."""
ALIKE_U_UM, ALIKE_SIGMAS = 0.1, 4.0
ALIKE_V = 0.1
LONGEST_GAP_S = 0.25
"""Voltages are compared where no frame is missing before the contact: three samples at the slowest rate."""
BEYOND_UM = 2.0
"""A tool may be so far beyond the greatest displacement of a touch before the controller's slow reading shows it."""


def contradicts_samples(told_um: float, seen_um: Floats) -> bool:
    """Whether a touch and the samples of its dwell say different things.

    The displacement of a touch is the mean of the sensor over the dwell, millisecond by millisecond; the samples of
    that time are some of the same readings. With n of them, and their own scatter s (noise of the sensor and the
    hunting), the two means should differ by zero within the standard uncertainty √(s²/n + ALIKE_U_UM²): the ends of
    the dwell are not the same, and the scatter of a few samples is hardly known. Over 54 touches on the virtual
    machine they differed by 0.05 µm rms with 10 samples and 0.03 µm with 30, 0.10 µm at most. Beyond ALIKE_SIGMAS of
    it, 0.4 to 0.5 µm, is a contradiction; of good touches that are one in 16 000 at most. Both sides count: no chip
    does that. Fewer than LEAST_SAMPLES contradict nothing.
    """
    n = len(seen_um)
    if n < LEAST_SAMPLES:
        return False
    u_um = math.hypot(float(seen_um.std(ddof=1)) / math.sqrt(n), ALIKE_U_UM)
    return abs(told_um - float(seen_um.mean())) > ALIKE_SIGMAS * u_um


def wrong_touch(
    event: MachineEvent, number: int, request: TouchRequest, blocks: Sequence[TelemetryBlock]
) -> str:
    """What in a touch cannot be, in words; nothing where all can.

    `number` of the touches that `request` asked for is due; `blocks` hold the samples of the whole motion so far.

    The voltage at first contact lies beyond the last sample before it by no more than the feed goes from one sample
    to the next; 0.1 V more are allowed, 0.003 V were seen. One sample of the dwell at least must show contact.
    """
    if event.argument != number or number > request.touches:
        return f"touch {event.argument} of {request.touches} where {number} is due"
    told_um = event.displacement_um
    if told_um > request.z_max_um + BEYOND_UM:
        return f"a touch at {told_um:.1f} µm, {request.z_max_um:.1f} µm was the limit"
    if not blocks:
        return ""
    samples = joined(blocks)
    first = int(np.searchsorted(samples.time_s, event.time_s))
    dwell = slice(first, int(np.searchsorted(samples.time_s, event.time_s + request.dwell_s, side="right")))
    seen_um = samples.displacement_um[dwell]
    if len(seen_um) < LEAST_SAMPLES:
        return ""
    if not np.any(samples.flags[dwell] & TelemetryFlag.CONTACT):
        return f"a touch at {told_um:.2f} µm, and no sample in contact"
    if contradicts_samples(told_um, seen_um):
        return f"a touch at {told_um:.2f} µm, the samples of it at {float(seen_um.mean()):.2f} µm"
    before_v = samples.actuator_v[max(first - 3, 0) : first]
    if len(before_v) == 3 and np.ptp(samples.time_s[first - 3 : first + 1]) < LONGEST_GAP_S:
        apart_v = abs(event.actuator_v - float(before_v[-1]))
        if apart_v > ALIKE_V + float(np.abs(np.diff(before_v)).max()):
            return f"a touch at {event.actuator_v:.2f} V, the sample before it at {float(before_v[-1]):.2f} V"
    return ""
