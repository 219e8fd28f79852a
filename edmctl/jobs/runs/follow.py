"""The newest state of a run that another process writes, as those who watch a job see it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

from edmctl.jobs.runs.summary import (
    DEBUG,
    LEFT_OUT,
    WARNING_LEVEL,
    depths_of_holes,
    events_of,
    place_of_move,
)
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
_SLOW_NAMES = (
    *("time", "s_ref", "r_open", "r_normal", "r_arc", "r_short", "feed_um_s", "jump_period"),
    *("est_depth", "est_depth_u95", "est_wear", "est_wear_u95"),
)


def pause() -> None:
    """Wait until the next look."""
    time.sleep(LOOK_EVERY_S)


def follow_run(path: Path, reporter: Observer, wait: Callable[[], None] = pause) -> Path:
    """Report the state of the run at `path` until it ends; return the final name of the file.

    Only the newest earlier decisions are reported. Raises RunFileError: E9008 its writer died, else as `open_run`.
    """
    watcher: _Watcher | None = None
    for run in follow(path, wait):
        watcher = watcher or _Watcher(run)
        watcher.report(run, reporter)
    return final_name(path, wait)


class _Watcher:
    """Remembers what was reported, and derives the state of the job from its events and samples."""

    def __init__(self, run: RunFile) -> None:
        values = run.profile_values()
        open_v, duty = (plain_number(values.get(f"pulse.{name}")) for name in ("open_voltage_v", "duty"))
        self._mean_open_v = open_v * duty
        self._places = max(1, len(depths_of_holes(values)))
        kind = values.get("target.kind")
        self._target_um = plain_number(values.get("target.depth_um")) if kind == "depth" else math.nan
        self._by_feed = kind == "feed"
        self._events_read: int | None = None
        self._site = self._step = self._warning = ""
        self._done = self._jumps = 0
        self._last_jump_s = self._warned_s = math.nan
        self._planned_s = self._feed_um = self._wear_ratio = math.nan
        self._cut_begin = (math.nan, math.nan)
        """Time of the first row of the cut, and feed of the hole before it."""

    def report(self, run: RunFile, reporter: Observer) -> None:
        """Report the newest state, and the events since the last one."""
        events = events_of(run, self._events_read or 0)
        for event in events:
            self._take(event)
        news = [e for e in events if e.level != DEBUG and e.code not in LEFT_OUT and e.code != "JUMPED"]
        if self._events_read is not None:
            for event in news:
                reporter.note(event.message)
        elif not run.is_finished:
            for event in news[-EARLIER:]:
                reporter.note(f"At {duration(event.time_s)}: {event.message}")
        self._events_read = (self._events_read or 0) + len(events)
        if rows := run.rows("/entry/servo"):
            reporter.progress(self._state(run, rows - 1))

    def _take(self, event: FileEvent) -> None:
        if event.code == "STAGE_MOVED":
            place = place_of_move(event)
            self._site = "" if place in (PAD, PARKING) else place
        elif event.code == "CUT_PLANNED":
            self._step, self._jumps, self._last_jump_s = f"cut {event.args.get('cut', '')}", 0, math.nan
            self._planned_s, self._cut_begin = event.time_s, (math.nan, math.nan)
            self._feed_um = plain_number(event.args.get("feed_um"))
            self._wear_ratio = plain_number(event.args.get("wear_ratio"))
            self._target_um = plain_number(event.args.get("target_um", self._target_um))
        elif event.code == "CUT_ENDED":
            self._step = ""
        elif event.code == "JUMPED":
            self._jumps, self._last_jump_s = self._jumps + 1, event.time_s
        elif event.code in ("TARGET_REACHED", "TARGET_MISSED"):
            self._done += 1
        if event.level >= WARNING_LEVEL:
            self._warning, self._warned_s = event.message, event.time_s

    def _state(self, run: RunFile, row: int) -> Progress:
        """Return the state at the newest row of the servo."""
        time_s, gap_v, sensor_um, model_um, state = (
            float(run.column("/entry/servo", name, row, row + 1)[0])
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
            time_left_s=self._time_left_s(run, time_s, fed_um, self._target_um - depth_um),
            depth_u95_um=slow.get("est_depth_u95", math.nan),
            site=self._site if self._places > 1 else "",
            step=self._step,
            feed_um=fed_um,
            feed_target_um=self._feed_um if self._by_feed else math.nan,
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

    def _time_left_s(self, run: RunFile, now_s: float, fed_um: float, depth_left_um: float) -> float:
        """Return the time at the cut's mean feed to the target depth, else to the end of the feed; NaN if unknown.

        fed_um : estimated depth and wear of the hole; depth_left_um : NaN without a target depth
        """
        if math.isnan(self._cut_begin[0]) and not math.isnan(self._planned_s):
            times_s = run.column("/entry/slow", "time")
            row = int(times_s.searchsorted(self._planned_s))
            if row < len(times_s):
                names = ("est_depth", "est_wear")
                lengths_um = [float(run.column("/entry/slow", name, row, row + 1)[0]) for name in names]
                self._cut_begin = float(times_s[row]), sum(lengths_um)
        begin_s, begin_um = self._cut_begin
        mean_um_s = (fed_um - begin_um) / (now_s - begin_s) if now_s - begin_s > FEED_AFTER_S else math.nan
        if not mean_um_s > 0.0:
            return math.nan
        left_um = depth_left_um * (1.0 + self._wear_ratio)
        if math.isnan(depth_left_um):
            left_um = self._feed_um - (fed_um - begin_um)
        return max(0.0, left_um) / mean_um_s


def _newest_slow(run: RunFile, now_s: float) -> dict[str, float]:
    """Return the newest row of the supervisor; empty if it is old because nothing is machined."""
    rows = run.rows("/entry/slow")
    row = {name: run.column("/entry/slow", name, max(0, rows - 1), rows) for name in _SLOW_NAMES}
    newest = {name: float(values[0]) for name, values in row.items() if len(values)}
    return newest if now_s - newest.get("time", -math.inf) <= PULSES_S else {}


def _phase(state: int, *, machining: bool) -> Phase:
    """Return the phase of a job for a controller state."""
    if state == MachineState.JUMP:
        return Phase.JUMPING
    if state == MachineState.MACHINING or machining:
        return Phase.MACHINING
    others = {MachineState.APPROACH: Phase.APPROACHING, MachineState.TOUCH: Phase.MEASURING}
    return others.get(MachineState(state), Phase.MOVING)
