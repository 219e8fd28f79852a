"""A channel that an earlier run left in the middle.

Pad and floor are touched again, as for a hole (decision 0022). The floor has a step where the run ended: it is
anywhere between the last whole layer and the one that was begun, so the first measurement is one after a pass that
ended early.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edmctl.errors import MachineFault
from edmctl.procedures.channel.layers import Layers
from edmctl.procedures.channel.scan import PassPlan, PassResult
from edmctl.procedures.channel.touching import ChannelSurface, ExtraUncertainty
from edmctl.procedures.hole.hole_estimate import (
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
from edmctl.procedures.touch.surface_plane import SurfacePlane
from edmctl.process.channel import HeldTool
from edmctl.process.path import Way
from edmctl.process.touches import DepthAndWear, share_u
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.results.job import ChannelResult

FACE_SD_UM = 0.5
"""A floor that differs by more from place to place is no untouched surface."""


class ChannelLeft:
    """The channel that an earlier run left, by its journal.

    `stops` is the number of its measurement cycles, `is_gap_learned` whether one has measured the gap of a held
    tool.
    """

    def __init__(self, run: JobRun, state: JobState) -> None:
        self._run, self._state, self._channel = run, state, state.channel
        self.stops, self.is_gap_learned = int(state.channel["stops"]), bool(state.channel["gap_learned"])
        self._step_um = state.channel["aim_um"] - state.channel["depth_um"]
        # A held tool cuts no deeper than its layer in the end.
        unseen_um = self._step_um
        if state.machining_time_s >= PERIOD_S:
            unseen_um = FASTER * PERIOD_S * (state.depth_um + state.wear_um) / state.machining_time_s
        self._expected = ExpectedHole(estimate_left(state), unseen_um)

    def surface(self) -> ChannelSurface:
        """Return the surface and the pad as the earlier run has touched them."""
        report_unknown_pause(self._run)
        surface = SurfacePlane(self._run)
        surface.restore(self._state.face, self._state.face_doubt_u_um)
        return ChannelSurface(z1_left_by(self._run, self._state), surface.plane, surface.doubt_u_um)

    def restore(self, layers: Layers, way: Way) -> tuple[PassPlan, PassResult]:
        """Set the layers by estimate; return the last pass as far as it is known, with a tool that was not held."""
        state, left, tally = self._state, self._channel, self._run.tally
        layers.sums = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
        layers.layers, layers.gap_um = int(left["layers"]), left["gap_um"]
        layers.depth_um, layers.aim_um = left["depth_um"], left["aim_um"]
        layers.wear.per_uj, layers.wear.u_rel = left["wear_per_uj"], left["wear_u_rel"]
        layers.wear.restart(state.wear_um)
        tally.depth_um, tally.unmeasured_site = state.depth_um, self._run.profile.meta.name
        held = HeldTool(layers.surface.z1.z_um, layers.surface.plane, layers.aim_um, layers.gap_um)
        limits_um = np.array([held.z_um((float(x), float(y)), state.wear_um) for x, y in way.points])
        plan = PassPlan(way, 0.0, held, uj_per_um=0.0, since_uj=0.0, rest_s=0.0)
        return plan, PassResult(limits_um, np.zeros(len(way.points)))

    def unknown(self) -> ExtraUncertainty:
        """Return how far pad and floor may be from where they are expected: a mistake is found, not missed."""
        expected = self._expected
        drift_um = STANDARD_UNCERTAINTIES * pause_drift_u_um(self._run.job)
        return ExtraUncertainty(
            pad_u_um=(expected.reach_um(expected.estimate.wear) + drift_um + BEYOND_UM) / BEYOND_SIGMAS,
            floor_u_um=(expected.depth_reach_um + BEYOND_UM) / BEYOND_SIGMAS,
            step_u_um=share_u(0.5 * self._step_um),
        )

    def add_hint(self, fault: MachineFault) -> None:
        """Add to the fault of a touch what a missing surface may mean."""
        if fault.code == NO_CONTACT:
            fault.hint += " Work, place or tool may not be those that the journal tells of."

    def refuse_other(self, surface: ChannelSurface, result: ChannelResult, uneven_um: float) -> None:
        """Record what was found if it can be the channel; the floor may be uneven by `uneven_um` between its places.

        Raises PreconditionError E8060, E8061 if it cannot.
        """
        run = self._run
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
        refuse_other(run, site, self._expected, found, untouched=untouched, begun=False)
        if untouched:
            # Hardly begun, or another workpiece, of whose surface only the floor is known.
            doubt_u_um = math.hypot(share_u(found.depth_um), found.depth_noise_um)
            surface.doubt_u_um = math.hypot(surface.doubt_u_um, doubt_u_um)
            run.keeper.doubt_surface(doubt_u_um)
        report_resumed(run, self._expected.estimate, found.depth_um, found.wear_um)
