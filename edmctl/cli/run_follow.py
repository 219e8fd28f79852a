"""The newest state of a run that another process writes, as those who watch a job see it."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from edmctl.console.story import PAD

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.cli.run_explain import FileEvent
    from edmctl.console.progress import Reporter
    from edmctl.procedures.results import Phase, Progress
    from edmctl.record.reader import RunFile

LOOK_EVERY_S = 0.5
_LATEST_S = 2.0
"""Gap voltage and displacement are shown with their range over this time."""
_SAMPLES = 4000
"""Rows that are read for that, at up to 1 kHz."""
WARNING_LEVEL = 2
_SITE_ENDS = ("TARGET_REACHED", "TARGET_MISSED")


def pause() -> None:
    """Wait until the next look."""
    time.sleep(LOOK_EVERY_S)


def follow_run(path: Path, reporter: Reporter, wait: Callable[[], None] = pause) -> Path:
    """Report the state of the run at `path` until it has an end; return what the file is called then.

    What was told before the first look is not told again. Raises RunFileError: E9008 its writer died, else as
    `open_run`.
    """
    from edmctl.record.following import final_name, follow

    watcher: _Watcher | None = None
    for run in follow(path, wait):
        if watcher is None:
            watcher = _Watcher(run)
        watcher.report(run, reporter)
    return final_name(path, wait)


class _Watcher:
    """Knows what has been told already, and what the events say about where the job stands."""

    def __init__(self, run: RunFile) -> None:
        from edmctl.cli.run_explain import depths_of_holes

        values = run.profile_values()
        self._mean_open_v = _number(values.get("pulse.open_voltage_v")) * _number(values.get("pulse.duty"))
        self._places = max(1, len(depths_of_holes(values)))
        by_depth = values.get("target.kind") == "depth"
        self._target_um = _number(values.get("target.depth_um")) if by_depth else math.nan
        self._seen = 0
        self._tells = False
        self._site = self._step = self._warning = ""
        self._done = self._jumps = 0
        self._last_jump_s = self._warned_s = math.nan

    def report(self, run: RunFile, reporter: Reporter) -> None:
        """Report the newest state, and the events since the last one."""
        from edmctl.cli.run_explain import events_of

        for event in events_of(run, self._seen):
            self._seen += 1
            self._take(event)
            if self._tells and _is_news(event):
                reporter.note(event.message)
        self._tells = True
        state = self._state(run)
        if state is not None:
            reporter.progress(state)

    def _take(self, event: FileEvent) -> None:
        if event.code == "STAGE_MOVED":
            place = event.message.removeprefix("At ").rpartition(" (")[0]
            self._site = self._site if place == PAD else place
        elif event.code == "CUT_PLANNED":
            self._step, self._jumps, self._last_jump_s = f"cut {event.args.get('cut', '')}", 0, math.nan
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
        from edmctl.procedures.results import Progress, PulseRatios

        rows = run.rows("/entry/servo")
        if not rows:
            return None
        servo = {
            name: run.column("/entry/servo", name, max(0, rows - _SAMPLES), rows).astype(float)
            for name in ("time", "v_gap_avg", "z_sensor", "z_model", "state")
        }
        now_s = float(servo["time"][-1])
        latest = servo["time"] >= now_s - _LATEST_S
        gap_v = servo["v_gap_avg"][latest]
        has_sensor = math.isfinite(servo["z_sensor"][-1])
        height_um = servo["z_sensor" if has_sensor else "z_model"][latest]
        slow = _newest_slow(run, now_s)
        return Progress(
            phase=_phase(int(servo["state"][-1]), machining=bool(slow)),
            time_s=now_s,
            gap_v=float(gap_v[-1]),
            reference_v=slow.get("s_ref", math.nan) * self._mean_open_v,
            ratios=PulseRatios(*(slow.get(f"r_{name}", 0.0) for name in ("open", "normal", "arc", "short"))),
            depth_um=slow.get("est_depth", math.nan),
            depth_target_um=self._target_um,
            displacement_um=float(height_um[-1]),
            time_left_s=math.nan,
            depth_u95_um=slow.get("est_depth_u95", math.nan),
            site=self._site if self._places > 1 else "",
            step=self._step,
            feed_um_s=slow.get("feed_um_s", math.nan),
            wear_um=slow.get("est_wear", math.nan),
            gap_low_v=float(gap_v.min()),
            gap_high_v=float(gap_v.max()),
            displacement_low_um=float(height_um.min()),
            displacement_high_um=float(height_um.max()),
            jumps=self._jumps,
            jump_period_s=slow.get("jump_period", math.nan),
            last_jump_s=self._last_jump_s,
            sites_done=self._done,
            sites_total=self._places,
            warning=self._warning,
            warned_s=self._warned_s,
        )


def _newest_slow(run: RunFile, now_s: float) -> dict[str, float]:
    """The newest row of the supervisor's view; empty where it is not of now, because nothing is machined."""
    rows = run.rows("/entry/slow")
    if not rows:
        return {}
    names = ("time", "s_ref", "r_open", "r_normal", "r_arc", "r_short", "est_depth", "est_depth_u95")
    more = ("est_wear", "feed_um_s", "jump_period")
    row = {name: run.column("/entry/slow", name, rows - 1, rows) for name in (*names, *more)}
    found = {name: float(values[0]) for name, values in row.items() if len(values)}
    return found if now_s - found["time"] <= _LATEST_S else {}


def _phase(state: int, *, machining: bool) -> Phase:
    """What the state of the controller comes to in the words of a job."""
    from edmctl.machine.states import MachineState
    from edmctl.procedures.results import Phase

    if state == MachineState.JUMP:
        return Phase.JUMPING
    if state == MachineState.MACHINING or machining:
        return Phase.MACHINING
    return {
        MachineState.APPROACH: Phase.APPROACHING,
        MachineState.TOUCH: Phase.MEASURING,
    }.get(MachineState(state), Phase.MOVING)


def _is_news(event: FileEvent) -> bool:
    from edmctl.console.story import DEBUG, LEFT_OUT

    return event.level != DEBUG and event.code not in LEFT_OUT and event.code != "JUMPED"


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
