"""The touches of a channel: the surface before it, floor and pad at every measurement, and the gap by them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.procedures.channel.scan import PassPlan, PassResult
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import ExpectedBottom, read_expected
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.procedures.touch.spots import (
    OFFSET_U_UM,
    ToolLength,
    drift_between,
    pad_u_um,
    read_pad,
    refuse_grown_tool,
)
from edmctl.procedures.touch.surface_plane import SurfacePlane
from edmctl.process.channel import ToolWear, Way, even_places
from edmctl.process.plane import Plane
from edmctl.process.touches import TOUCH_PRIOR_DOF, DepthAndWear, Drift, against_sparks, is_short
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.results.job import FloorPlace

FACE_CANDIDATES = 24  # places of the path from which those for the plane are chosen
FLOOR_U_UM = 1.0  # standard uncertainty of the floor before it is touched: gap and unevenness [assumed]
TOUCH_LEAST_SD_UM = 0.1  # least standard deviation of touches: better agreement is by chance
PAD_U_SHARE = 0.15  # standard uncertainty of the pad, as a share of the wear since its last touch
UNEVEN_U_UM = 0.5  # standard uncertainty of the height of an evened floor from place to place [assumed]

Touched = tuple[float, "Place", "SurfaceReading"]
"""Length along the path, place and reading of one touch of the floor."""


@dataclass(slots=True, eq=False)
class ChannelSurface:
    """The untouched surface: the pad before the channel, and a plane through it and places of the path.

    `doubt_u_um` is a standard uncertainty on top of the plane's, since something contradicted it.
    """

    z1: SurfaceReading
    plane: Plane
    doubt_u_um: float = 0.0


@dataclass(frozen=True, slots=True)
class ExtraUncertainty:
    """Additional standard uncertainties of a resumed channel, µm; `step_u_um` is from place to place of the
    floor.
    """

    pad_u_um: float = 0.0
    floor_u_um: float = 0.0
    step_u_um: float = 0.0


NO_EXTRA = ExtraUncertainty()


@dataclass(frozen=True, slots=True)
class FloorReading:
    """The touches of one measurement: the pad, the floor at places of the path, and the pad again."""

    places: tuple[FloorPlace, ...]
    floor: tuple[SurfaceReading, ...]
    pad_before: SurfaceReading
    pad: SurfaceReading

    @property
    def depth_um(self) -> float:
        """Mean depth."""
        return math.fsum(place.depth_um for place in self.places) / len(self.places)

    @property
    def sd_um(self) -> float:
        """Standard deviation of the depths; 0 of a single one."""
        return (
            float(np.std([place.depth_um for place in self.places], ddof=1)) if len(self.places) > 1 else 0.0
        )

    def lengths(self, run: JobRun, surface: ChannelSurface, uneven_um: float = 0.0) -> DepthAndWear:
        """Return mean depth, wear and feed, of a floor that may be deeper by `uneven_um` between its places.

        The scatter of the floor from place to place counts too, as only some were touched. The pad is touched before
        and after the floor, so a steady drift is no part of the depth.
        """
        sensor_u, z1, places = run.uncertainty, surface.z1, len(self.floor)
        by_rests = drift_between(run, z1, self.pad)
        drift = by_rests or Drift(0.0, sensor_u.drifted_u_um(self.pad.time_s - z1.time_s))
        pads = (z1, self.pad_before, self.pad)
        dof = TOUCH_PRIOR_DOF + sum(r.reading.touches - 1 for r in (*pads, *self.floor))
        meeting_u_um = pad_u_um(run.setup)
        z1_u_um, before_u_um, after_u_um = (
            max(r.reading.sd_um, TOUCH_LEAST_SD_UM) / math.sqrt(r.reading.touches) for r in pads
        )
        depth_u_um = math.hypot(
            self.sd_um / math.sqrt(places),
            0.5 * uneven_um,
            before_u_um / 2.0,
            after_u_um / 2.0,
            sensor_u.length_u_um(self.depth_um),
            max(surface.plane.height_u_um(place.x_um, place.y_um) for place in self.places),
            surface.doubt_u_um,
            meeting_u_um,
            math.fsum(z2.doubt_u_um for z2 in self.floor) / places,
            0.5 * (self.pad_before.doubt_u_um + self.pad.doubt_u_um),
        )
        wear_um = self.pad.z_um - drift.um - z1.z_um
        wear_u_um = math.hypot(
            z1_u_um,
            after_u_um,
            sensor_u.length_u_um(wear_um),
            drift.left_u_um,
            meeting_u_um,
            z1.doubt_u_um,
            self.pad.doubt_u_um,
        )
        return DepthAndWear(
            depth=Value(self.depth_um, depth_u_um, dof),
            wear=Value(wear_um, wear_u_um, dof),
            feed=Value(self.depth_um + wear_um, math.hypot(depth_u_um, wear_u_um), dof),
            depth_noise_um=depth_u_um,
            drift_um=drift.um,
            drift_left_u_um=drift.left_u_um,
            drift_by_rests=by_rests is not None,
        )


def touch_untouched(run: JobRun, way: Way) -> ChannelSurface:
    """Touch the pad (Z1), then the surface at places of the path: its tilt would otherwise enter the floor."""
    expected_um = run.tally.home_um + run.profile.approach.offset_um
    z1 = read_pad(run, "Z1", run.profile.meta.name, expected_um, OFFSET_U_UM)
    candidates = [_place(run, way, s_um) for s_um in even_places(way, FACE_CANDIDATES)]
    surface = SurfacePlane(run)
    surface.fit_pad_slope(z1)
    surface.touch_plane(candidates, ToolLength(z1))
    surface.keep()
    return ChannelSurface(z1, surface.plane, surface.doubt_u_um)


def measure_floor(
    run: JobRun,
    surface: ChannelSurface,
    plan: PassPlan,
    done: PassResult,
    wear: ToolWear,
    since_uj: float,
    places: int,
    unknown: ExtraUncertainty = NO_EXTRA,
) -> FloorReading:
    """Touch the pad, the floor at places along the path of the pass just done, and the pad again.

    `since_uj` is the wearing energy since the pad was touched last. Between the two readings of the pad its height
    is interpolated, because in these minutes the sensor drifts by as much as the floor may be uneven.
    """
    wear_um = wear.um(since_uj)
    pad_u_um = math.hypot(PAD_U_SHARE * wear.per_uj * since_uj, unknown.pad_u_um)
    floor_u_um = math.hypot(FLOOR_U_UM, unknown.floor_u_um)
    before = _touch_pad(run, surface, surface.z1.z_um + wear_um, pad_u_um, unknown)
    touched: list[Touched] = []
    for s_um in even_places(plan.way, places):
        place = _place(run, plan.way, s_um)
        height_um = plan.held.floor_um((place.x_um, place.y_um), 0.0) - plan.held.pad_um
        predicted_um = before.z_um + height_um
        move_to(run, place)
        touched.append((s_um, place, take_reading(run, "Z2", place.name, predicted_um, floor_u_um)))
    if done.held or unknown is not NO_EXTRA:
        touched = _short_ones_again(run, plan, done, wear, touched, unknown.step_u_um)
    after = _touch_pad(run, surface, before.z_um, 0.0, unknown)
    floor = []
    for s_um, place, z2 in touched:
        share = (z2.time_s - before.time_s) / (after.time_s - before.time_s)
        pad_um = before.z_um + share * (after.z_um - before.z_um)
        # Where the tool would have met the untouched surface at that time.
        surface_um = pad_um + surface.plane.height_um(place.x_um, place.y_um)
        floor.append(FloorPlace(s_um, place.x_um, place.y_um, z2.z_um - surface_um))
    return FloorReading(tuple(floor), tuple(z2 for _, _, z2 in touched), before, after)


def _short_ones_again(
    run: JobRun,
    plan: PassPlan,
    done: PassResult,
    wear: ToolWear,
    touched: Sequence[Touched],
    step_u_um: float,
) -> list[Touched]:
    """Touch again where the floor is shorter than the other places and the held tool allow.

    The tool was held alike everywhere, so it left the same gap apart from the unevenness of the floor.
    """
    ends_um = [_held_um(plan, done, wear, s_um) for s_um, _, _ in touched]
    gap_um = statistics.median(z2.z_um - end_um for (_, _, z2), end_um in zip(touched, ends_um, strict=True))
    u_um = math.hypot(UNEVEN_U_UM, step_u_um, wear.u_rel * wear.per_uj * done.wearing_uj)
    found: list[Touched] = []
    for (s_um, place, z2), end_um in zip(touched, ends_um, strict=True):
        off = against_sparks(z2.z_um, end_um, gap_um, u_um)
        if not is_short(off, gap_um):
            found.append((s_um, place, z2))
            continue
        run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"Z2 = {z2.z_um:.2f} µm at {place.name} is {-off.um:.2f} µm short of what the held tool left elsewhere "
            "(a chip?). It is touched again.",
            {"kind": "Z2", "off_um": off.um, "u_um": off.u_um, "z_um": z2.z_um},
        )
        run.recorder.append(RejectedTouch(z2.time_s))
        move_to(run, place)
        expected = ExpectedBottom(end_um, gap_um, u_um, "the held tool and the other places")
        found.append((s_um, place, read_expected(run, place.name, expected)))
    return found


def _touch_pad(
    run: JobRun, surface: ChannelSurface, predicted_um: float, pad_u_um: float, unknown: ExtraUncertainty
) -> SurfaceReading:
    """Touch the pad (Z3). The tool of a resumed channel is compared together with the floor."""
    z1 = surface.z1
    z3 = read_pad(run, "Z3", run.profile.meta.name, predicted_um, pad_u_um)
    if unknown is NO_EXTRA:
        refuse_grown_tool(run, z1.z_um, z3, z3.time_s - z1.time_s, z1.doubt_u_um)
    return z3


def learned_gap_um(
    plan: PassPlan, done: PassResult, found: FloorReading, wear: ToolWear, believed_um: float
) -> float:
    """Return the mean gap that a pass left between the held tool and the floor; `believed_um` if it is unknown.

    A tool that was not held, and doubted touches, show no gap.
    """
    gaps_um = [
        z2.z_um - _held_um(plan, done, wear, place.s_um)
        for place, z2 in zip(found.places, found.floor, strict=True)
        if z2.doubt_u_um == 0.0 and done.held
    ]
    return math.fsum(gaps_um) / len(gaps_um) if gaps_um else believed_um


def _held_um(plan: PassPlan, done: PassResult, wear: ToolWear, s_um: float) -> float:
    """Return where the tool was held at a place, for the tool after the rest of the pass, which is shorter."""
    held_um = float(np.interp(s_um, plan.way.lengths_um, done.limits_um))
    used_uj = float(np.interp(s_um, plan.way.lengths_um, done.used_uj))
    return held_um + wear.per_uj * (done.wearing_uj - used_uj)


def _place(run: JobRun, way: Way, s_um: float) -> Place:
    x_um, y_um = way.at(s_um)
    return Place(f"{s_um:.0f} µm along the path", x_um, y_um)
