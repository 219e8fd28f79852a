"""A channel that an earlier run left in the middle: what is written down of it, and how it is taken up.

Pad and floor are touched again, as for a hole ([0022]). The floor has a step where the run ended: it lies anywhere
between the last whole layer and the one that was begun, so the first stop is one after a pass that ended early.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edmctl.errors import MachineFault, PreconditionError
from edmctl.procedures.channel.layers import GAP_GROWTH, Layers
from edmctl.procedures.channel.scan import PassPlan, PassResult
from edmctl.procedures.channel.touching import FLOOR_U_UM, ChannelSurface, ExtraUncertainty
from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.hole.hole_estimate import (
    BELIEF_U_REL,
    FASTER,
    STANDARD_UNCERTAINTIES,
    ExpectedHole,
    estimate_left,
    is_untouched,
)
from edmctl.procedures.hole.resuming import (
    BEYOND_UM,
    refuse_other,
    report_resumed,
    report_unknown_pause,
    z1_left_by,
)
from edmctl.procedures.job_state import PERIOD_S, CutTotals, JobState
from edmctl.procedures.monitoring.drift import pause_drift_u_um
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.reading import BEYOND_SIGMAS, NO_CONTACT
from edmctl.procedures.touch.surface_plane import level_surface
from edmctl.process.channel import HeldTool, wearing_uj
from edmctl.process.discharge import first_gap_u_um
from edmctl.process.path import Way
from edmctl.process.touches import DepthAndWear, share_u
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.results.job import ChannelResult

FACE_SD_UM = 0.5
"""A floor that differs by more from place to place is no untouched face."""


def channel_state(
    run: JobRun,
    surface: ChannelSurface,
    layers: Layers,
    stops: int,
    *,
    learned: bool,
    state: JobState,
    now_s: float,
) -> JobState:
    """Add to a state what a run that goes on has to know of the channel.

    The floor is somewhere between the last layer and the one under way; where it was left, and how much the tool
    has worn, is by the energy since the last stop.
    """
    cut, sums, z1 = run.tally.cut, layers.sums, surface.z1
    pulse = run.profile.pulse
    since_uj = layers.since_uj + wearing_uj(energy_of(pulse, cut.counts, cut.energy_j))
    low_um, high_um = layers.depth_um, max(layers.depth_um, layers.aim_um)
    between_um = share_u(0.5 * (high_um - low_um))
    believed_gap_u_um = GAP_GROWTH * first_gap_u_um(pulse.open_voltage_v)
    gap_u_um = FLOOR_U_UM if learned else max(FLOOR_U_UM, believed_gap_u_um)
    drift_um = run.uncertainty.drift_u_um_per_s * max(0.0, now_s - layers.since_s)
    believed_um = BELIEF_U_REL * layers.wear.per_uj * since_uj
    wear_u_um = math.hypot(layers.wear.u_um(since_uj), believed_um, drift_um)
    total = sums.plus(cut.counts, cut.energy_j, cut.time_s)
    return replace(
        state,
        site=run.profile.meta.name,
        begun=sums.number > 0 or cut.time_s > 0.0 or state.phase == "machining",
        z1_um=z1.z_um,
        z1_sd_um=z1.reading.sd_um,
        z1_touches=z1.reading.touches,
        z1_doubt_u_um=z1.doubt_u_um,
        z1_time_s=run.tally.earlier_time_s + z1.time_s,
        z1_model_um=z1.model_um,
        displacement_um=0.0 if math.isnan(cut.displacement_um) else cut.displacement_um,
        depth_um=0.5 * (low_um + high_um),
        depth_u_um=math.hypot(between_um, gap_u_um, wear_u_um),
        wear_um=layers.wear.um(since_uj),
        wear_u_um=wear_u_um,
        feed_u_um=math.hypot(between_um, gap_u_um, drift_um),
        cuts=sums.number + (cut.time_s > 0.0),
        counts=total.counts,
        energy_j=total.energy_j,
        machining_time_s=total.time_s,
        channel={
            "layers": layers.layers,
            "depth_um": low_um,
            "aim_um": high_um,
            "gap_um": layers.gap_um,
            "gap_learned": float(learned),
            "wear_per_uj": layers.wear.per_uj,
            "wear_u_rel": layers.wear.u_rel,
            "stops": stops,
        },
    )


def channel_begun(run: JobRun) -> JobState | None:
    """Return what an earlier run of the job has left of the channel; None where it had not begun to cut."""
    state = run.job.resumed
    return state if state is not None and state.begun else None


def surface_left_by(run: JobRun, state: JobState) -> ChannelSurface:
    """Return the face and the pad as the earlier run has touched them."""
    report_unknown_pause(run)
    surface = level_surface(run)
    surface.restore(state.face, state.face_doubt_u_um)
    return ChannelSurface(z1_left_by(run, state), surface.plane, surface.doubt_u_um)


def go_on_from(run: JobRun, state: JobState, layers: Layers, way: Way) -> tuple[PassPlan, PassResult]:
    """Put layers where the earlier run has left them, by estimate; return its last pass, as far as anybody knows it.

    That one says where the floor is looked for, and that the tool was not held all along.
    """
    left = _channel(state)
    layers.sums = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
    layers.layers, layers.gap_um = int(left["layers"]), left["gap_um"]
    layers.depth_um, layers.aim_um = left["depth_um"], left["aim_um"]
    layers.wear.per_uj, layers.wear.u_rel = left["wear_per_uj"], left["wear_u_rel"]
    layers.wear.restart(state.wear_um)
    run.tally.depth_um, run.tally.unmeasured_site = state.depth_um, run.profile.meta.name
    held = HeldTool(layers.surface.z1.z_um, layers.surface.plane, layers.aim_um, layers.gap_um)
    limits_um = np.array([held.z_um((float(x), float(y)), state.wear_um) for x, y in way.points])
    plan = PassPlan(way, 0.0, held, uj_per_um=0.0, since_uj=0.0, rest_s=0.0)
    return plan, PassResult(limits_um, np.zeros(len(way.points)))


def stops_left(state: JobState) -> tuple[int, bool]:
    """Return how many measuring stops there were, and whether one has measured the gap that a held tool leaves."""
    left = _channel(state)
    return int(left["stops"]), bool(left["gap_learned"])


def expected_of_channel(state: JobState) -> ExpectedHole:
    """Return what to expect of the channel that was left; a held tool cuts no deeper at last than its layer."""
    left = _channel(state)
    unseen_um = left["aim_um"] - left["depth_um"]
    if state.machining_time_s >= PERIOD_S:
        unseen_um = FASTER * PERIOD_S * (state.depth_um + state.wear_um) / state.machining_time_s
    return ExpectedHole(estimate_left(state), unseen_um)


def unknown_of_left(run: JobRun, state: JobState) -> ExtraUncertainty:
    """Return how far pad and floor may be from where they are expected: a mistake is found, not missed."""
    expected, left = expected_of_channel(state), _channel(state)
    drift_um = STANDARD_UNCERTAINTIES * pause_drift_u_um(run.job)
    return ExtraUncertainty(
        pad_u_um=(expected.wear_reach_um + drift_um + BEYOND_UM) / BEYOND_SIGMAS,
        floor_u_um=(expected.depth_reach_um + BEYOND_UM) / BEYOND_SIGMAS,
        step_u_um=share_u(0.5 * (left["aim_um"] - left["depth_um"])),
    )


def with_journal_hint(fault: MachineFault) -> MachineFault:
    """Return the fault of a touch, with what a missing surface may mean."""
    if fault.code == NO_CONTACT:
        fault.hint += " Work, place or tool may not be those that the journal tells of."
    return fault


def refuse_other_channel(
    run: JobRun, state: JobState, surface: ChannelSurface, result: ChannelResult, uneven_um: float
) -> None:
    """Say what was found, where it can be what was left; the floor may be uneven by so much between its places.

    Raises PreconditionError E8060, E8061 where it cannot.
    """
    expected = expected_of_channel(state)
    even = DepthAndWear(
        depth=Value(result.depth_um, result.depth_u_um),
        wear=Value(result.wear_um, result.wear_u_um),
        feed=Value(result.feed_um, result.feed_u_um),
        depth_noise_um=result.depth_u_um,
    )
    found = replace(even, depth=even.depth.widened(uneven_um), feed=even.feed.widened(uneven_um))
    untouched = is_untouched(even) and result.floor_sd_um < FACE_SD_UM
    path = run.profile.path
    assert path is not None
    site = Place(result.name, path.x_um, path.y_um)
    refuse_other(run, site, expected, found, untouched=untouched, begun=False)
    if untouched:
        # Hardly begun, or on other work, whose face is not the one that was touched but for what the floor shows.
        doubt_u_um = math.hypot(share_u(found.depth_um), found.depth_noise_um)
        surface.doubt_u_um = math.hypot(surface.doubt_u_um, doubt_u_um)
        run.keeper.doubt_surface(doubt_u_um)
    report_resumed(run, expected.estimate, found.depth_um, found.wear_um)


def _channel(state: JobState) -> dict[str, float]:
    if not state.channel:
        raise PreconditionError(
            "The journal tells nothing of the channel that was begun.",
            hint="Machine a new channel at another place or on new work.",
            code="E8052",
        )
    return dict(state.channel)
