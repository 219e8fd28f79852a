"""The touches of a channel: the surface before it, floor and pad at every measurement, and the gap by them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.procedures.job import Counts
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import read_expected
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.procedures.touch.surfaces import (
    OFFSET_U_UM,
    SurfacePlane,
    ToolLength,
    drift_between,
    pad_u_um,
    read_pad,
    refuse_grown_tool,
)
from edmctl.process.channel import HeldTool, ToolWear, Way, even_places
from edmctl.process.plane import Plane
from edmctl.process.touches import TOUCH_PRIOR_DOF, DepthAndWear, Drift, against_sparks, is_short
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.results.job import FloorPlace

FACE_CANDIDATES = 24  # places of the path from which those for the plane are chosen
FLOOR_U_UM = 1.0  # standard uncertainty of a floor that was not touched: gap and unevenness [assumed]
TOUCH_LEAST_SD_UM = 0.1  # least standard deviation of touches: better agreement is by chance
PAD_U_SHARE = 0.15  # standard uncertainty of the pad, as a share of the wear since its last touch
UNEVEN_U_UM = 0.5  # standard uncertainty of the height of an evened floor from place to place [assumed]
HELD_ENOUGH = 0.8  # a layer is cut if the tool was at its limit on this share of the path

Touched = tuple[float, "Place", "SurfaceReading"]  # length along the path, place and reading


@dataclass(frozen=True, slots=True, eq=False)
class PassPlan:
    """One pass: its way and speed, where the tool is held, and the expected wearing energy per length.

    `since_uj` is the wearing energy from the last touch of the pad to this pass, `rest_s` the machining time after
    it, `wear_u_um` the standard uncertainty of the wear before it, without that by energy.
    """

    way: Way
    speed_um_s: float
    held: HeldTool
    uj_per_um: float
    since_uj: float
    rest_s: float
    number: int = 0
    wear_u_um: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PassResult:
    """Result of a pass; `fault` names the row of the faults that ended it early, `message` the reason.

    `counts` are pulses by class (open, normal, arc, short), `wearing_uj` the energy that wore the tool. `limits_um`
    is the limit at each point of the way, `used_uj` the wearing energy of the pass when the tool was there, shape
    (n,).
    """

    limits_um: Array
    used_uj: Array
    time_s: float = 0.0
    held_share: float = 0.0
    gap_ratio_mean: float = math.nan
    counts: Counts = (0, 0, 0, 0)
    energy_j: float = 0.0
    wearing_uj: float = 0.0
    fault: str = ""
    message: str = ""

    @property
    def held(self) -> bool:
        """Whether the tool was at its limit on nearly all of the path."""
        return not self.fault and self.held_share >= HELD_ENOUGH

    @property
    def open_share(self) -> float:
        return self.counts[0] / max(1, sum(self.counts))


@dataclass(slots=True, eq=False)
class ChannelSurface:
    """Pad before the channel, plane through it and places of the path, and an additional standard uncertainty."""

    z1: SurfaceReading
    plane: Plane
    doubt_u_um: float = 0.0


Extra = tuple[float, float, float]
"""Additional standard uncertainties of a resumed channel, µm: pad, floor, and floor from place to place."""
NO_EXTRA: Extra = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FloorReading:
    """The touches of one measurement: the pad, the floor at places of the path, and the pad again."""

    places: tuple[FloorPlace, ...]
    floor: tuple[SurfaceReading, ...]
    pad_before: SurfaceReading
    pad: SurfaceReading

    @property
    def depth_um(self) -> float:
        return math.fsum(place.depth_um for place in self.places) / len(self.places)

    @property
    def sd_um(self) -> float:
        depths_um = [place.depth_um for place in self.places]
        return float(np.std(depths_um, ddof=1)) if len(depths_um) > 1 else 0.0

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
        wear_um, doubts = self.pad.z_um - drift.um - z1.z_um, (z1.doubt_u_um, self.pad.doubt_u_um)
        length_u_um = sensor_u.length_u_um(wear_um)
        wear_u_um = math.hypot(z1_u_um, after_u_um, length_u_um, drift.left_u_um, meeting_u_um, *doubts)
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
    candidates = [_place(way, s_um) for s_um in even_places(way, FACE_CANDIDATES)]
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
    extra: Extra = NO_EXTRA,
) -> FloorReading:
    """Touch the pad, the floor at places along the path of the pass just done, and the pad again.

    `since_uj` is the wearing energy since the pad was touched last. Between the two readings of the pad its height
    is interpolated, because in these minutes the sensor drifts by as much as the floor may be uneven.
    """
    z1, wear_um = surface.z1, wear.um(since_uj)

    def touch_pad(predicted_um: float, u_um: float) -> SurfaceReading:
        z3 = read_pad(run, "Z3", run.profile.meta.name, predicted_um, u_um)
        if extra is NO_EXTRA:  # the tool of a resumed channel is compared together with the floor
            refuse_grown_tool(run, z1.z_um, z3, z3.time_s - z1.time_s, z1.doubt_u_um)
        return z3

    extra_pad_u_um, extra_floor_u_um, step_u_um = extra
    pad_u_um = math.hypot(PAD_U_SHARE * wear.per_uj * since_uj, extra_pad_u_um)
    before = touch_pad(z1.z_um + wear_um, pad_u_um)
    floor_u_um = math.hypot(FLOOR_U_UM, extra_floor_u_um)
    touched: list[Touched] = []
    for s_um in even_places(plan.way, places):
        place = _place(plan.way, s_um)
        height_um = plan.held.floor_um((place.x_um, place.y_um), 0.0) - plan.held.pad_um
        move_to(run, place)
        touched.append(
            (s_um, place, take_reading(run, "Z2", place.name, before.z_um + height_um, floor_u_um))
        )
    if done.held or extra is not NO_EXTRA:
        touched = _short_ones_again(run, plan, done, wear, touched, step_u_um)
    after = touch_pad(before.z_um, 0.0)
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
    """Touch again where the floor is shorter than the other places and the tool, held alike everywhere, allow."""
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
        source = "the held tool and the other places"
        found.append((s_um, place, read_expected(run, place.name, end_um, gap_um, u_um, source)))
    return found


def learned_gap_um(
    plan: PassPlan, done: PassResult, found: FloorReading, wear: ToolWear, assumed_um: float
) -> float:
    """Return the mean gap between held tool and floor; `assumed_um` if not held, or if all touches are in doubt."""
    gaps_um = [
        z2.z_um - _held_um(plan, done, wear, place.s_um)
        for place, z2 in zip(found.places, found.floor, strict=True)
        if z2.doubt_u_um == 0.0 and done.held
    ]
    return math.fsum(gaps_um) / len(gaps_um) if gaps_um else assumed_um


def _held_um(plan: PassPlan, done: PassResult, wear: ToolWear, s_um: float) -> float:
    """Return where the tool was held at a place, for the tool after the rest of the pass, which is shorter."""
    held_um = float(np.interp(s_um, plan.way.lengths_um, done.limits_um))
    used_uj = float(np.interp(s_um, plan.way.lengths_um, done.used_uj))
    return held_um + wear.per_uj * (done.wearing_uj - used_uj)


def _place(way: Way, s_um: float) -> Place:
    return Place(f"{s_um:.0f} µm along the path", *way.at(s_um))
