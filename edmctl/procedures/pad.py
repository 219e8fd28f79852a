"""The reference pad, touched at two spots: a chip under the tool lies at one of them and not at the other.

The spots are further apart than the tool is wide. Where they do not agree further ones decide: what lies under a
tool shortens a reading, so the longest reading counts as soon as another spot confirms it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import ObjectiveNotReached
from edmctl.procedures.approach import lower_to
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.job import Site
from edmctl.procedures.measuring import displacement_uncertainty
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch import (
    BEYOND_PREDICTION_UM,
    Search,
    SurfaceReading,
    constant,
    search_near,
    take_reading_in,
)
from edmctl.process.touch_check import agreeing_spots, is_constant
from edmctl.process.wear import pooled_reading, tilt_uncertainty_um
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.procedures.run import Run

SPOT_MARGIN_UM = 30.0
"""Between the tool's edges at two spots: wider than a chip that a gap of some µm lets through."""
SPOT_TURNS_DEG = (0.0, 60.0, -60.0)
"""Directions of the further spots as seen from the pad, from that away from the holes: all are equally far apart."""
SPOT_LEG_UM = 2.0
"""At a further spot the fast leg ends this far above where contact was before."""
SPOT_SETTLE_S = 0.2
RAMP_CLEAR_UM = 25.0
"""A blind ramp ends this far above it: a ramp that runs into a chip is a fault, a touch that does is not."""
WORTH_A_RAMP_UM = 20.0
"""A shorter way than this is left to the fast leg of the touch."""


def read_pad(run: Run, kind: str, place: str, predicted_um: float, u_um: float) -> SurfaceReading:
    """Touch the pad at two spots, and at up to two more where they do not agree.

    Contact is expected at `predicted_um` with a standard uncertainty of `u_um`. There are at least `measure.touches`
    touches in all. Raises ObjectiveNotReached E7022 where no two spots agree on the longest reading.
    """
    spots = pad_spots(run)
    search = search_near(run, predicted_um, u_um)
    later = max(1, search.touches // 3)
    move_to(run, spots[0])
    search = replace(search, touches=max(1, search.touches - later))
    found = [take_reading_in(run, kind, place, search)]
    for spot in spots[1:]:
        move_to(run, spot)
        found.append(_at_further_spot(run, kind, place, found, replace(search, touches=later)))
        readings = [one.reading for one in found]
        if is_constant(readings):
            raise constant(found[-1])
        agreeing = agreeing_spots(readings, _place_u_um(run, spots, found))
        if len(agreeing) > 1:
            return _together(run, found, agreeing, spots)
    told = ", ".join(f"{one.z_um:.2f}" for one in found)
    raise ObjectiveNotReached(
        f"{kind}: no two of {len(found)} spots of the reference pad agree on the longest reading: {told} µm.",
        hint="Clean tool and work, and look whether the pad is flat for a tool's width around its place.",
        code="E7022",
    )


def pad_spots(run: Run) -> tuple[Site, ...]:
    """The pad's place, and those beside it on the side away from the holes."""
    pad, sites = run.job.pad, run.job.sites
    distance_um = spot_distance_um(run)
    x_um = math.fsum(site.x_um for site in sites) / len(sites) - pad.x_um
    y_um = math.fsum(site.y_um for site in sites) / len(sites) - pad.y_um
    away = math.atan2(-y_um, -x_um)
    angles = (away + math.radians(turn) for turn in SPOT_TURNS_DEG)
    beside = (
        Site(pad.name, pad.x_um + distance_um * math.cos(a), pad.y_um + distance_um * math.sin(a))
        for a in angles
    )
    return (pad, *beside)


def spot_distance_um(run: Run) -> float:
    """How far the spots are from each other."""
    return run.profile.tool.diameter_um + SPOT_MARGIN_UM


def _at_further_spot(
    run: Run, kind: str, place: str, found: Sequence[SurfaceReading], first: Search
) -> SurfaceReading:
    near_um = max(one.z_um for one in found)
    ramp_um = near_um - RAMP_CLEAR_UM
    if run.setup.sensor.fitted and ramp_um - run.watch.displacement_um > WORTH_A_RAMP_UM:
        lower_to(run, ramp_um)
    z_max_um = max(first.z_max_um, near_um + BEYOND_PREDICTION_UM)
    search = replace(first, fast_to_um=near_um - SPOT_LEG_UM, z_max_um=z_max_um, settle_s=SPOT_SETTLE_S)
    return take_reading_in(run, kind, place, search)


def _place_u_um(run: Run, spots: Sequence[Site], found: Sequence[SurfaceReading]) -> float:
    """Standard uncertainty of the difference between two spots: tilt, drift, and a model instead of a sensor."""
    known = displacement_uncertainty(run.job)
    return math.hypot(
        _tilt_u_um(run, spots),
        known.drift_u_um_per_s * (found[-1].time_s - found[0].time_s),
        0.0 if run.setup.sensor.fitted else known.linearity_u_um,
    )


def _tilt_u_um(run: Run, spots: Sequence[Site]) -> float:
    setup = run.setup
    distance_um = math.hypot(spots[1].x_um - spots[0].x_um, spots[1].y_um - spots[0].y_um)
    return tilt_uncertainty_um(setup.surface.tilt_u_mrad, distance_um, setup.stage.repeatability_um)


def _together(
    run: Run, found: Sequence[SurfaceReading], agreeing: Sequence[int], spots: Sequence[Site]
) -> SurfaceReading:
    """One reading of the spots that agree; others than usual lie a little differently, by the tilt between them."""
    used = [found[i] for i in agreeing]
    touches = sum(one.reading.touches for one in used)
    shares = [one.reading.touches / touches for one in used]
    usual = tuple(agreeing) == (0, 1)
    if not usual:
        left_out = ", ".join(f"{one.z_um:.2f}" for one in found if one not in used)
        counted = " and ".join(f"{one.z_um:.2f}" for one in used)
        run.decide(
            RunEvent.TOUCH_DOUBTED,
            f"{found[0].kind}: {counted} µm at two spots of the pad agree. Something lay under the tool at another, "
            f"{left_out} µm, which does not count.",
            {"kind": found[0].kind, "shortest_um": min(one.z_um for one in found), "z_um": used[-1].z_um},
            level=EventLevel.WARNING,
        )
    return replace(
        used[-1],
        reading=pooled_reading([one.reading for one in used]),
        model_um=math.fsum(share * one.model_um for share, one in zip(shares, used, strict=True)),
        actuator_v=math.fsum(share * one.actuator_v for share, one in zip(shares, used, strict=True)),
        zero_um=math.fsum(share * one.zero_um for share, one in zip(shares, used, strict=True)),
        doubt_u_um=0.0 if usual else _tilt_u_um(run, spots),
    )
