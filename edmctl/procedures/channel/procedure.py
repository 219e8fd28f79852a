"""A channel by layers: touch the face, scan layer after layer with the tool held, touch floor and pad, correct.

Where the floor ends up below a held tool, and how much the tool wears on the way, is learned at every measuring
stop, so the last layers are cut by what was measured and not by what was assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import MachineFault
from edmctl.labels import NOT_SHOWN_CODE, Verdict
from edmctl.machine.interface import host_fault
from edmctl.planning.channel import LAYERS_BEFORE_FIRST_STOP, PLACES, PLACES_AT_THE_END
from edmctl.procedures.channel.layers import Layers
from edmctl.procedures.channel.result import channel_left, channel_result, channel_row
from edmctl.procedures.channel.resuming import (
    channel_begun,
    channel_state,
    go_on_from,
    refuse_other_channel,
    stops_left,
    surface_left_by,
    unknown_of_left,
    with_journal_hint,
)
from edmctl.procedures.channel.touching import ChannelSurface, FloorReading, measure_floor, touch_untouched
from edmctl.procedures.channel.way import way_of_path
from edmctl.procedures.hole.cut import Decision
from edmctl.procedures.hole.site_result import REMEDIES, judged_channel, not_shown
from edmctl.procedures.job import HoleTarget, target_of
from edmctl.procedures.job_state import JobState, UnderWay
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.process.channel import layer_depths_um
from edmctl.process.next_cut import NOISE_FLOOR_SIGMAS
from edmctl.process.path import Way
from edmctl.process.touches import TOUCH_U_UM
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.job import ChannelResult
from edmctl.wording import length, plural, signed

LEAST_SUNK_SHARE = 0.25
"""A layer that takes more passes than it may, twice what the recipe believes and some, is measured: its work may
erode slower, or its tool wear less than the energy tells, so that the tool is held too deep to get there. Where the
floor has not even sunk by this share of the layer, the tool has stopped advancing."""


def machine_channel(
    run: JobRun, limits: TimeLimits, keep: Callable[[ChannelResult], None]
) -> tuple[ChannelResult | None, Decision]:
    """Machine the channel of `profile.path`; the result of the last measuring stop, and how it ended.

    `keep` takes the result of every measuring stop, so that the last one is there whatever comes next. The result
    is None where the time was up before anything was cut.
    """
    path = run.profile.path
    if path is None:
        raise ValueError("the profile has no channel")
    way = way_of_path(path)
    target = target_of(run.profile)
    run.tally.depth_um, run.tally.open_site = 0.0, run.profile.meta.name
    run.tally.depth_target_um = target.depth_um
    left = channel_begun(run)
    surface = touch_untouched(run, way) if left is None else surface_left_by(run, left)
    layers = Layers(run, limits, way, surface, path.speed_um_s)
    stops = _MeasuringStops(run, target, way, surface, layers, keep)
    try:
        if left is not None:
            ended = _ended(run, target, stops.resume(left), last=False)
            if ended is not None:
                return stops.result, ended
        return _cut_down(run, target, layers, stops, path.layer_um)
    except BaseException:
        stops.leave()
        raise


def _cut_down(
    run: JobRun, target: HoleTarget, layers: Layers, stops: _MeasuringStops, layer_um: float
) -> tuple[ChannelResult | None, Decision]:
    """Cut layer by layer, and measure where that is due, to the end."""
    corrections = run.profile.wear.max_cuts
    while True:
        depths_um = layer_depths_um(layers.depth_um, target.depth_um, layer_um)
        last = len(depths_um) == 1
        even_out = last or stops.due(len(depths_um) - 1)
        from_um = layers.depth_um
        fault, message = layers.cut(depths_um[0], len(depths_um) - 1, even_out=even_out)
        if not (fault or even_out):
            continue
        if not fault:
            result = stops.measure(PLACES_AT_THE_END if last else PLACES)
        elif layers.since_uj > 0.0:
            result = stops.measure(PLACES)
        else:
            return stops.result, _missed(run, target, fault, message, stops.result)
        sunk_um = result.depth_um - from_um
        if fault and not (layers.behind and sunk_um >= LEAST_SUNK_SHARE * (depths_um[0] - from_um)):
            return result, _missed(run, target, fault, message, result)
        corrections -= last
        ended = _ended(run, target, result, last=last and corrections <= 0)
        if ended is not None:
            return result, ended
        ended_early = f" The last layer ended early: {message}." if message else ""
        left_um = target.depth_um - result.depth_um
        again = max(1, len(layer_depths_um(result.depth_um, target.depth_um, layer_um)))
        run.decide(
            RunEvent.CUT_DECIDED,
            f"{left_um:.2f} µm are left, in {plural(again, 'layer')}.{ended_early}",
            {"left_um": left_um, "layers": again},
        )


def _ended(run: JobRun, target: HoleTarget, result: ChannelResult, *, last: bool) -> Decision | None:
    """Return the end at the target, after the `last` stop or with a worn tool; None where more is to be cut."""
    worn_out = _worn_out(run, target, result)
    if worn_out is not None:
        return worn_out
    enough_um = max(target.tolerance_um / 2.0, NOISE_FLOOR_SIGMAS * TOUCH_U_UM)
    if last or target.depth_um - result.depth_um <= enough_um:
        return _final(run, target, result)
    return None


@dataclass(slots=True, eq=False)
class _MeasuringStops:
    """The measuring stops of a channel: when the next is due, and what they find."""

    run: JobRun
    target: HoleTarget
    way: Way
    surface: ChannelSurface
    layers: Layers
    keep: Callable[[ChannelResult], None]
    result: ChannelResult | None = None
    _number: int = 0
    _learned: bool = False

    def __post_init__(self) -> None:
        self.layers.keep = partial(self._keep_state, "machining")
        if channel_begun(self.run) is None:
            self._keep_state("measuring")

    def due(self, layers_after: int) -> bool:
        """Return whether to measure after the next layer, with so many left after it.

        After the second layer for wear and gap; whenever the tool's face is no longer known to half the tolerance;
        and before the last layer, which is to end at the target, where it is not known to a quarter.
        """
        if not self._learned and self.layers.layers + 1 >= LAYERS_BEFORE_FIRST_STOP:
            return True
        unknown = self.layers.wear_u_um / self.target.tolerance_um
        return unknown > 0.5 or (layers_after == 1 and unknown > 0.25)

    def measure(self, places: int) -> ChannelResult:
        """Touch floor and pad, learn from them, and keep the result."""
        layers = self.layers
        if layers.last is None:
            raise ValueError("nothing was cut")
        plan, done = layers.last
        found = measure_floor(self.run, self.surface, plan, done, layers.wear, layers.since_uj, places)
        uneven_um = abs(plan.held.depth_um - layers.depth_um) if done.fault else 0.0
        layers.learn(found)
        self._learned |= done.held
        return self._keep_result(found, self._result(found, uneven_um))

    def resume(self, left: JobState) -> ChannelResult:
        """Touch floor and pad where an earlier run has left them, and keep the result; its journal stands till then.

        Raises PreconditionError E8060, E8061 where they are not as they were left.
        """
        run, layers = self.run, self.layers
        self._number, self._learned = stops_left(left)
        plan, done = go_on_from(run, left, layers, self.way)
        unknown = unknown_of_left(run, left)
        try:
            found = measure_floor(run, self.surface, plan, done, layers.wear, 0.0, PLACES_AT_THE_END, unknown)
        except MachineFault as fault:
            raise with_journal_hint(fault) from fault
        uneven_um = layers.aim_um - layers.depth_um
        refuse_other_channel(run, left, self.surface, self._result(found, 0.0), uneven_um)
        layers.resume(found)
        return self._keep_result(found, self._result(found, uneven_um))

    def _result(self, found: FloorReading, uneven_um: float) -> ChannelResult:
        layers = self.layers
        return channel_result(
            self.run,
            self.way.length_um,
            self.surface,
            found,
            layers.sums,
            layers=layers.layers,
            gap_um=layers.gap_um,
            stops=self._number + 1,
            uneven_um=uneven_um,
        )

    def _keep_result(self, found: FloorReading, result: ChannelResult) -> ChannelResult:
        self._number += 1
        self.result = result
        self.layers.measured_u_um = result.wear_u_um
        self.run.tally.depth_um, self.run.tally.unmeasured_site = found.depth_um, ""
        self.keep(result)
        self._keep_state("measuring")
        self._report(found, result)
        return result

    def _keep_state(self, phase: str) -> None:
        """Write down how far the channel has come, for a run that goes on with it."""
        self.run.keeper.keep(phase, UnderWay(self._state), self.run.machine.time_s)

    def _state(self, state: JobState, now_s: float) -> JobState:
        return channel_state(
            self.run, self.surface, self.layers, self._number, learned=self._learned, state=state, now_s=now_s
        )

    def leave(self) -> None:
        """Keep by estimate what was cut since the last stop, where the channel is left before the next."""
        run, layers = self.run, self.layers
        if self.result is not None and run.tally.unmeasured_site:
            # A short may have pulled the tool back; the floor stays where it is.
            run.tally.depth_um = max(run.tally.depth_um, layers.depth_um, self.result.depth_um)
            left = channel_left(
                self.result,
                layers.sums,
                layers=layers.layers,
                depth_um=run.tally.depth_um,
                most_um=max(run.tally.depth_um, layers.aim_um),
                wear_um=layers.wear.um(layers.since_uj),
            )
            self.keep(left)

    def _report(self, found: FloorReading, result: ChannelResult) -> None:
        self.run.decide(
            RunEvent.CHANNEL_MEASURED,
            f"Floor {length(result.depth_um, result.depth_u95_um)} deep, {found.sd_um:.2f} µm rms from "
            f"place to place, wear {length(result.wear_um, result.wear_u95_um)}; a held tool leaves a gap "
            f"of {result.working_gap_um:.2f} µm.",
            {
                "depth_um": result.depth_um,
                "depth_u95_um": result.depth_u95_um,
                "floor_sd_um": found.sd_um,
                "wear_um": result.wear_um,
                "wear_u95_um": result.wear_u95_um,
                "gap_um": result.working_gap_um,
            },
        )


def _final(run: JobRun, target: HoleTarget, result: ChannelResult) -> Decision:
    """Return the end after the last layer: target reached, or missed by the depth or the evenness of the floor."""
    tolerance_um, target_um = target.tolerance_um, target.depth_um
    off_um = result.depth_um - target_um
    message = (
        f"Channel {result.depth_um:.2f} µm deep, {signed(off_um)} µm from the target, "
        f"{result.floor_sd_um:.2f} µm rms along the path, after {result.layers} layers in {result.passes} passes."
    )
    verdict = judged_channel(target, result).verdict
    if verdict is Verdict.SHOWN:
        run.decide(RunEvent.TARGET_REACHED, message, {"depth_um": result.depth_um})
        return Decision(None, message)
    if verdict is Verdict.NOT_SHOWN:
        message = f"{not_shown('The mean depth of the floor', target, result)}."
        hint = REMEDIES[result.depth_basis]
        run.decide(RunEvent.VERDICT, message, {"hint": hint}, level=EventLevel.WARNING)
        return Decision(None, message, message, hint, NOT_SHOWN_CODE)
    run.decide(RunEvent.TARGET_MISSED, message, {"depth_um": result.depth_um}, level=EventLevel.WARNING)
    return Decision(
        None,
        message,
        f"The floor is {result.depth_um:.2f} µm deep on average, {signed(off_um)} µm from the target, and "
        f"{result.floor_sd_um:.2f} µm rms uneven; target.tolerance_um is {tolerance_um:.1f} µm.",
        "Use thinner layers (path.layer_um) or a slower scan (path.speed_um_s), or allow more.",
    )


def _worn_out(run: JobRun, target: HoleTarget, result: ChannelResult) -> Decision | None:
    """Return the end where the tool has lost more than it may; None while it has not."""
    lost_um, limit_um = run.job.tool_wear_before_um + result.wear_um, run.profile.tool.max_wear_um
    if lost_um <= limit_um:
        return None
    message = (
        f"The tool has lost {lost_um:.0f} µm, tool.max_wear_um is {limit_um:.0f} µm; the channel ends at "
        f"{target.reached(result.depth_um, result.feed_um)}."
    )
    run.decide(RunEvent.TARGET_MISSED, message, {"wear_um": lost_um}, level=EventLevel.WARNING)
    return Decision(None, message, message, "Dress or change the tool, and machine the channel anew.")


def _missed(
    run: JobRun, target: HoleTarget, fault: str, message: str, result: ChannelResult | None
) -> Decision:
    """Return the end by a row of the faults, with what was reached."""
    depth_um = 0.0 if result is None else result.depth_um
    reached = f"a floor {depth_um:.2f} of {target.depth_um:g} µm deep"
    error = host_fault(fault, f" The channel ended early ({message}) at {reached}.")
    run.decide(RunEvent.TARGET_MISSED, error.message, {"depth_um": depth_um}, level=EventLevel.WARNING)
    return Decision(None, error.message, error.message, error.hint, error.code)


def machine_path(run: JobRun) -> Decision | None:
    """Machine the channel of the recipe; the decision where it missed its objective, None where it did not.

    Raises PreconditionError E8060, E8061 where it is not the channel, or the tool, that an earlier run has left.
    """
    path = run.profile.path
    assert path is not None

    def keep(result: ChannelResult) -> None:
        run.tally.channel = result

    result, decision = machine_channel(run, TimeLimits(run), keep)
    run.tally.open_site = run.tally.unmeasured_site = ""
    if result is not None:
        result = judged_channel(target_of(run.profile), result)
        keep(replace(result, finished=True))
        run.recorder.append(channel_row(run, result))
    return decision if decision.missed else None


def record_left_channel(run: JobRun) -> None:
    """Write what is known of a channel that was looked at, where its job ends early."""
    channel = run.tally.channel
    if channel is not None and not channel.finished:
        run.recorder.append(channel_row(run, channel))
