"""The newest state of a run that another process writes, as those who watch a job see it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

from edmctl.dataclasses import dataclass, field
from edmctl.jobs.runs.explanation import DEBUG, LEFT_OUT, depths_of_holes, events_of
from edmctl.labels import PAD, PARKING
from edmctl.machine.interface import MachineState
from edmctl.record.reader import RunFile, final_name, follow
from edmctl.results.progress import Observer, Phase, Progress
from edmctl.results.run_file import FileEvent
from edmctl.results.telemetry import PulseShares
from edmctl.wording import duration, plain_number

PULSES_S = 2.0
"""Without a row for this time there are no pulses: the supervisor writes at least two rows a second of them."""
LOOK_EVERY_S = 0.5
FEED_AFTER_S = 10.0
"""The mean feed of a cut is used from this time on: one jump period."""
EARLIER = 3
"""Number of earlier decisions that are printed at the first look."""
WARNING_LEVEL = 2
_SITE_ENDS = ("TARGET_REACHED", "TARGET_MISSED")


def pause() -> None:
    """Wait until the next look."""
    time.sleep(LOOK_EVERY_S)


def follow_run(path: Path, reporter: Observer, wait: Callable[[], None] = pause) -> Path:
    """Report the state of the run at `path` until it ends; return the final name of the file.

    Only the newest earlier decisions are reported. Raises RunFileError: E9008 its writer died, else as `open_run`.
    """
    watcher: _Watcher | None = None
    for run in follow(path, wait):
        if watcher is None:
            watcher = _Watcher(run)
        watcher.report(run, reporter)
    return final_name(path, wait)


class _Watcher:
    """Remembers what was reported, and derives the state of the job from its events."""

    def __init__(self, run: RunFile) -> None:
        values = run.profile_values()
        self._mean_open_v = plain_number(values.get("pulse.open_voltage_v")) * plain_number(
            values.get("pulse.duty")
        )
        self._places = max(1, len(depths_of_holes(values)))
        by_depth = values.get("target.kind") == "depth"
        self._target_um = plain_number(values.get("target.depth_um")) if by_depth else math.nan
        self._by_feed = values.get("target.kind") == "feed"
        self._cut = _Cut()
        self._seen = 0
        self._tells = False
        self._site = self._step = self._warning = ""
        self._done = self._jumps = 0
        self._last_jump_s = self._warned_s = math.nan

    def report(self, run: RunFile, reporter: Observer) -> None:
        """Report the newest state, and the events since the last one."""
        events = events_of(run, self._seen)
        self._seen += len(events)
        for event in events:
            self._take(event)
        news = [e for e in events if e.level != DEBUG and e.code not in LEFT_OUT and e.code != "JUMPED"]
        if self._tells:
            for event in news:
                reporter.note(event.message)
        elif not run.is_finished:
            for event in news[-EARLIER:]:
                reporter.note(f"At {duration(event.time_s)}: {event.message}")
        self._tells = True
        state = self._state(run)
        if state is not None:
            reporter.progress(state)

    def _take(self, event: FileEvent) -> None:
        if event.code == "STAGE_MOVED":
            place = event.message.removeprefix("At ").rpartition(" (")[0]
            self._site = "" if place in (PAD, PARKING) else place
        elif event.code == "CUT_PLANNED":
            self._step, self._jumps, self._last_jump_s = f"cut {event.args.get('cut', '')}", 0, math.nan
            self._cut = _Cut(
                event.time_s, *(plain_number(event.args.get(name)) for name in ("feed_um", "wear_ratio"))
            )
            self._target_um = plain_number(event.args.get("target_um", self._target_um))
        elif event.code == "CUT_ENDED":
            self._step = ""
        elif event.code == "JUMPED":
            self._jumps, self._last_jump_s = self._jumps + 1, event.time_s
        elif event.code in _SITE_ENDS:
            self._done += 1
        if event.level >= WARNING_LEVEL:
            self._warning, self._warned_s = event.message, event.time_s

    def _state(self, run: RunFile) -> Progress | None:
        """The newest state; None before the first sample."""
        rows = run.rows("/entry/servo")
        if not rows:
            return None
        time_s, gap_v, sensor_um, model_um, state = (
            float(run.column("/entry/servo", name, rows - 1, rows)[0])
            for name in ("time", "v_gap_avg", "z_sensor", "z_model", "state")
        )
        slow = _newest_slow(run, time_s)
        depth_um, wear_um = slow.get("est_depth", math.nan), slow.get("est_wear", math.nan)
        fed_um = depth_um + wear_um
        return Progress(
            phase=_phase(int(state), machining=bool(slow)),
            time_s=time_s,
            gap_v=gap_v,
            reference_v=slow.get("s_ref", math.nan) * self._mean_open_v,
            ratios=PulseShares(*(slow.get(f"r_{name}", 0.0) for name in ("open", "normal", "arc", "short"))),
            depth_um=depth_um,
            depth_target_um=self._target_um,
            displacement_um=sensor_um if math.isfinite(sensor_um) else model_um,
            time_left_s=self._cut.time_left_s(run, time_s, fed_um, self._target_um - depth_um),
            depth_u95_um=slow.get("est_depth_u95", math.nan),
            site=self._site if self._places > 1 else "",
            step=self._step,
            feed_um=fed_um,
            feed_target_um=self._cut.feed_um if self._by_feed else math.nan,
            feed_um_s=slow.get("feed_um_s", math.nan),
            wear_um=wear_um,
            wear_u95_um=slow.get("est_wear_u95", math.nan),
            jumps=self._jumps,
            jump_period_s=slow.get("jump_period", math.nan),
            last_jump_s=self._last_jump_s,
            sites_done=self._done,
            sites_total=self._places,
            warning=self._warning,
            warned_s=self._warned_s,
        )


@dataclass(slots=True)
class _Cut:
    """A cut that was planned at `planned_s`, with its remaining time at the mean feed so far."""

    planned_s: float = math.nan
    feed_um: float = math.nan
    wear_ratio: float = math.nan
    _begin: tuple[float, float] = field(default=(math.nan, math.nan), init=False)
    """Time of its first row, and feed of the hole before it."""

    def time_left_s(self, run: RunFile, now_s: float, fed_um: float, depth_left_um: float) -> float:
        """Return the time to the target depth, else to the end of the feed; NaN while that is unknown.

        fed_um : estimated depth and wear of the hole; depth_left_um : NaN without a target depth
        """
        if math.isnan(self._begin[0]):
            self._begin = self._found_begin(run)
        begin_s, begin_um = self._begin
        mean_um_s = (fed_um - begin_um) / (now_s - begin_s) if now_s - begin_s > FEED_AFTER_S else math.nan
        if not mean_um_s > 0.0:
            return math.nan
        left_um = depth_left_um * (1.0 + self.wear_ratio)
        if math.isnan(depth_left_um):
            left_um = self.feed_um - (fed_um - begin_um)
        return max(0.0, left_um) / mean_um_s

    def _found_begin(self, run: RunFile) -> tuple[float, float]:
        times_s = run.column("/entry/slow", "time")
        row = int(times_s.searchsorted(self.planned_s))
        if math.isnan(self.planned_s) or row >= len(times_s):
            return math.nan, math.nan
        lengths_um = (run.column("/entry/slow", name, row, row + 1) for name in ("est_depth", "est_wear"))
        return float(times_s[row]), sum(float(values[0]) for values in lengths_um)


def _newest_slow(run: RunFile, now_s: float) -> dict[str, float]:
    """Return the newest row of the supervisor; empty if it is old because nothing is machined."""
    rows = run.rows("/entry/slow")
    names = ("time", "s_ref", "r_open", "r_normal", "r_arc", "r_short", "est_depth", "est_depth_u95")
    more = ("est_wear", "est_wear_u95", "feed_um_s", "jump_period")
    row = {name: run.column("/entry/slow", name, max(0, rows - 1), rows) for name in (*names, *more)}
    found = {name: float(values[0]) for name, values in row.items() if len(values)}
    return found if now_s - found.get("time", -math.inf) <= PULSES_S else {}


def _phase(state: int, *, machining: bool) -> Phase:
    """Return the phase of a job for a controller state."""
    if state == MachineState.JUMP:
        return Phase.JUMPING
    if state == MachineState.MACHINING or machining:
        return Phase.MACHINING
    others = {MachineState.APPROACH: Phase.APPROACHING, MachineState.TOUCH: Phase.MEASURING}
    return others.get(MachineState(state), Phase.MOVING)
