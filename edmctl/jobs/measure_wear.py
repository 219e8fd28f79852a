"""`measure-wear`: touch the reference pad, or measure wear, depth and feed against that reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.dataclasses import asdict, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.connected_machine import Now
from edmctl.jobs.corrections import choose_drift
from edmctl.jobs.ledger.prepared_job import coordinates_in
from edmctl.jobs.ledger.tool import (
    NAMELESS,
    ToolIdentity,
    account_of,
    diameter_of,
    last_run_of,
    left_to_finish,
    reference_command,
    reference_setup,
    refuse_other_setup,
    refuse_unknown_length,
    setup_differences,
    tool_identity,
    with_recipe_of,
)
from edmctl.jobs.plan import Plan
from edmctl.jobs.procedures import Procedure, expected_pad_um, job_with_home
from edmctl.jobs.run_context import RunContext
from edmctl.jobs.runs.opening import command_to_go_on
from edmctl.jobs.surroundings import Warn
from edmctl.planning.measuring import move_time_s, park_to_pad_um, reading_time_s, touch_time_s
from edmctl.procedures.measure_wear import (
    LEAST_TOUCHES,
    Bottom,
    Reference,
    measure_wear,
    refuse_drift,
    touch_pad,
)
from edmctl.procedures.monitoring.drift import counted_pause_s
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.profile.model import Profile
from edmctl.record.ledger import (
    UNFINISHED,
    Ledger,
    MachineHistory,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolAccount,
    ToolChanged,
    WearMeasured,
    history_of,
)
from edmctl.results.declared import shared
from edmctl.results.measurements import WearResult
from edmctl.wording import length

TOUCHES_LIKE = "cu270"
"""The shipped profile by which a tool without any run is touched if none is named."""


def measuring_profile(profile: Profile, speed_um_s: float = math.nan) -> Profile:
    """Return the recipe with enough touches of every Z, and with the speed of the reference, if given."""
    measure = profile.measure
    changes: dict[str, object] = {"touches": max(LEAST_TOUCHES, measure.touches)}
    if not math.isnan(speed_um_s):
        changes["speed_um_s"] = speed_um_s
    return profile.model_copy(update={"measure": measure.model_copy(update=changes)})


class _Touches(Procedure):
    """Touches of the pad by the tool with this `account`."""

    name = "measure-wear"
    account: ToolAccount
    _temperature_c: float
    """Of the dielectric."""

    def forecast(self) -> dict[str, Any]:
        """Return readings, touches, speed and duration."""
        profile, setup = measuring_profile(self.plan.loaded.profile), self.plan.setup
        return {
            "readings": ["Z1"],
            "touches": profile.measure.touches,
            "speed_um_s": profile.measure.speed_um_s,
            "time_s": touch_time_s(profile, setup),
        }


class ReferenceTouch(_Touches):
    """A reference touch: Z1 of the tool in the machine."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.touched: SurfaceReading | None = None

    def look(self, plan: Plan, identity: ToolIdentity, ledger: Ledger | None, warn: Warn) -> Plan:
        """Read the tool's account, and return the plan with the recipe of its last run if no profile was named.

        Raises PreconditionError E8063 for a run with an unknown recipe.
        """
        self.account = account = account_of(
            plan, identity, history_of(ledger.lines if ledger else (), identity.serial)
        )
        if setup_differences(account.reference, plan.setup):
            account.pad_um = math.nan
        if ledger is None:
            warn([_NOT_KEPT])
            return plan
        folder = ledger.path.parent
        if plan.new_tool:
            warn(left_to_finish(account.label, identity.serial, folder))
        return with_recipe_of(plan, folder, last_run_of(account))

    def carry_out(self, run: RunContext) -> None:
        """Touch the pad, and write the reference into the ledger."""
        run.plan = self.look(run.plan, tool_identity(run.bench), run.ledger, run.warn)
        self._temperature_c = run.bench.machine.status().temperature_c
        job = job_with_home(run, measuring_profile(run.plan.loaded.profile))
        with run.recording("wear reference", lambda: self.summary(run)):
            with run.armed(job) as job_run:
                # A job that was killed has left the tool anywhere between here and what all of it would have cost.
                half_um = 0.5 * math.fsum(job.wear_um for job in self.account.killed)
                home_um = job_run.tally.home_um
                expected_um = expected_pad_um(job_run, self.account) + half_um
                self.touched = touched = touch_pad(job_run, "Z1", expected_um, 0.5 * half_um)
                run.warn(_replaced(self.account, touched.z_um))
            tool = self.account.label
            reference = ReferenceTouched(
                tool=tool,
                run_file=run.file_name,
                z_um=touched.z_um,
                sd_um=touched.reading.sd_um,
                touches=touched.reading.touches,
                model_um=touched.model_um,
                speed_um_s=job.profile.measure.speed_um_s,
                time_s=touched.time_s,
                temperature_c=self._temperature_c,
                home_um=home_um,
                doubt_u_um=touched.doubt_u_um,
                truth={"tool_wear_um": run.bench.virtual.tool_wear_um} if run.bench.virtual else None,
                **reference_setup(run.plan.setup),
            )
            changed = [ToolChanged(tool)] if run.plan.new_tool else []
            run.write_down(*changed, reference, RunEnded(run.file_name, "done", run.tally.time_s))

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        """Return the reading, and whose it is."""
        if self.touched is None:
            return None
        reading = self.touched.reading
        return {
            "machine": run.bench.serial,
            "tool": self.account.label,
            "dielectric_c": self._temperature_c,
            "reference": {
                "z1_um": reading.mean_um,
                "sd_um": reading.sd_um,
                "touches": reading.touches,
                "z1_model_um": self.touched.model_um,
            },
        }


class WearMeasurement(_Touches):
    """A measurement of wear, depth and feed against the tool's reference, at the hole `site` or the last one.

    bottom : the hole that is touched, if any
    total_um : total wear since the tool was new
    truth : wear since the reference, depth and feed of a virtual bench; None on any other machine
    """

    bottom: Bottom | None
    _reference: Reference
    _profile: Profile

    def __init__(self, plan: Plan, site: str | None) -> None:
        """Raise UsageError E2062 for a new tool."""
        if plan.new_tool:
            raise failures.new_tool_without_reference()
        self.plan, self._site = plan, site
        self.found: WearResult | None = None
        self.total_um = math.nan
        self.truth: dict[str, float] | None = None

    def forecast(self) -> dict[str, Any]:
        """Return readings, touches, speed and duration."""
        profile, setup = measuring_profile(self.plan.loaded.profile), self.plan.setup
        deep_um = profile.approach.offset_um + self.plan.forecast.feed_um
        moves_s = 2.0 * move_time_s(max(profile.measure.site_dx_um, park_to_pad_um(setup)), setup)
        readings_s = reading_time_s(profile, deep_um) + reading_time_s(profile, profile.approach.offset_um)
        first = super().forecast()
        return {**first, "readings": ["Z3", "Z2", "Z3"], "time_s": first["time_s"] + moves_s + readings_s}

    def look(self, plan: Plan, identity: ToolIdentity, ledger: Ledger | None, warn: Warn) -> Plan:
        """Read the tool's account, its reference and the hole to touch; return the plan with the hole's recipe.

        Raises PreconditionError: E8041 no reference, E8045 no such hole, E8046 a hole too narrow for the tool,
        E8048 a tool whose job was killed, E8056 a tool that was replaced since its reference, E8059 a reference
        under another setup, E8063 a run with an unknown recipe.
        """
        history = history_of(ledger.lines if ledger else (), identity.serial)
        self.account = account = account_of(plan, identity, history)
        folder = ledger.path.parent if ledger is not None else Path()
        reference = _reference_of(account, ledger, identity, plan)
        self._reference = _aged(reference, account, identity.now)
        refuse_other_setup(account, history, plan, folder)
        refuse_unknown_length(account, folder, plan)
        diameter_um = plan.loaded.profile.tool.diameter_um
        if not plan.names_tool:
            diameter_um = diameter_of(account.label, identity)
        self.bottom = bottom_of(self._site, history, account, diameter_um, folder)
        plan = with_recipe_of(plan, folder, self.bottom.run_file if self.bottom else last_run_of(account))
        self._profile = _at_speed_of(reference, plan, warn)
        return plan

    def carry_out(self, run: RunContext) -> None:
        """Touch pad, hole and pad, and write the wear into the ledger."""
        run.plan = self.look(run.plan, tool_identity(run.bench), run.ledger, run.warn)
        plan = run.plan
        run.drift = choose_drift(
            plan.surroundings.environ, plan.setup, run.bench.serial, lasting=plan.where.lasting
        )
        run.warn(run.drift.warnings)
        self._temperature_c = run.bench.machine.status().temperature_c
        job = job_with_home(run, self._profile)
        with run.recording(self.name, lambda: self.summary(run)):
            with run.armed(job) as job_run:
                home_um, expected_um = job_run.tally.home_um, expected_pad_um(job_run, self.account)
                age_s = counted_pause_s(replace(job_run.job, pause_s=self._reference.age_s))
                reference = replace(self._reference, age_s=age_s, drift_um_per_s=run.drift.touch_um_per_s)
                self.found = found = measure_wear(job_run, reference, expected_um, self.bottom)
                self.total_um = self.account.lost_before_um + found.wear_um
                self.truth = self._truth(run)
                refuse_drift(job_run, found)
                run.warn(_contradictions(found, self.account))
            measured = WearMeasured(
                self.account.label,
                run.file_name,
                found.z3_after_um,
                found.wear_um,
                found.wear_u95_um,
                home_um,
            )
            run.write_down(measured, RunEnded(run.file_name, "done", run.tally.time_s))

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        """Return the measured values, and the ledger's wear of the tool."""
        if self.found is None:
            return None
        return {
            "machine": run.bench.serial,
            "tool": self.account.label,
            "dielectric_c": self._temperature_c,
            "site": asdict(self.bottom) if self.bottom else None,
            **asdict(self.found),
            "ledger": {"wear_um": self.account.worn_um, "wear_u95_um": self.account.worn_u95_um},
            "tool_wear_total_um": self.total_um,
            "truth": self.truth,
        }

    def _truth(self, run: RunContext) -> dict[str, float] | None:
        virtual, bottom = run.bench.virtual, self.bottom
        if virtual is None:
            return None
        before = self.account.reference.truth if self.account.reference else None
        wear_um = virtual.tool_wear_um - before["tool_wear_um"] if before else math.nan
        depth_um, holes = math.nan, virtual.truth()
        if bottom is not None and holes:
            nearest = min(holes, key=lambda h: math.hypot(h.x_um - bottom.x_um, h.y_um - bottom.y_um))
            depth_um = nearest.depth_um
        return {"wear_um": wear_um, "depth_um": depth_um, "feed_um": depth_um + wear_um}


def _contradictions(found: WearResult, account: ToolAccount) -> list[Diagnostic]:
    """Warn if the touches and the sum of the sites do not agree: something happened that no job knows of."""
    off_um, u95_um = found.wear_um - account.worn_um, math.hypot(found.wear_u95_um, account.worn_u95_um)
    if abs(off_um) <= u95_um:
        return []
    return [
        failures.tool_shorter_than_expected(
            wear_um=length(found.wear_um), worn_um=length(account.worn_um), u95_um=length(u95_um)
        )
    ]


MOST_NAMES = 8
"""Holes that a message lists."""


def bottom_of(
    asked: str | None, history: MachineHistory, account: ToolAccount, diameter_um: float, folder: Path
) -> Bottom | None:
    """Return the requested hole, or else the last measured hole of the tool; None without any.

    `folder` contains the run files.

    Raises PreconditionError: E8045 no such hole, or unknown depth; E8046 the tool does not fit into it.
    """
    if asked is None:
        made = [hole for hole in account.holes if hole.status != UNFINISHED]
        return _bottom(made[-1]) if made and not made[-1].through else None
    hole = _asked(asked, history.holes)
    if hole is None:
        names = "; ".join(
            f"{known.name} at {known.x_um:.0f},{known.y_um:.0f} of {known.run_file.removesuffix('.h5')}"
            for known in history.holes[-MOST_NAMES:]
        )
        raise failures.hole_unknown(asked=asked, names=names or "none")
    if hole.through:
        raise failures.hole_without_bottom(hole=hole.name)
    if math.isnan(hole.depth_um):
        run_file = folder / hole.run_file
        command = command_to_go_on(run_file)
        raise failures.hole_depth_unknown(
            hole=hole.name,
            run_file=run_file,
            remedy=f"Finish it with `{command}`, or name another hole with --site."
            if command
            else "Name another hole with --site.",
        )
    if diameter_um >= 2.0 * hole.radius_um:
        raise failures.tool_wider_than_hole(
            diameter_um=length(diameter_um), hole=hole.name, radius_um=length(2.0 * hole.radius_um)
        )
    return _bottom(hole)


def _asked(asked: str, holes: list[SiteMachined]) -> SiteMachined | None:
    """The last hole of that name or else of that run, or the one around that place."""
    place = coordinates_in(asked)
    if place is None:
        named = [hole for hole in holes if hole.name == asked]
        of_run = [hole for hole in holes if hole.run_file.removesuffix(".h5") == asked.removesuffix(".h5")]
        return next(reversed(named or of_run), None)
    x_um, y_um = place
    return next(
        (
            hole
            for hole in reversed(holes)
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) <= hole.radius_um
        ),
        None,
    )


def _bottom(hole: SiteMachined) -> Bottom:
    known = Bottom(hole.name, hole.x_um, hole.y_um, hole.depth_um, run_file=hole.run_file)
    return known if math.isnan(hole.depth_u_um) else replace(known, depth_u_um=hole.depth_u_um)


def _at_speed_of(reference: ReferenceTouched, plan: Plan, warn: Warn) -> Profile:
    """Touch as slowly as the reference was touched, so that creep enters both alike; a named profile decides."""
    profile = plan.loaded.profile
    if not plan.names_tool:
        return measuring_profile(profile, reference.speed_um_s)
    if profile.measure.speed_um_s != reference.speed_um_s:
        warn(
            [
                failures.reference_at_another_speed(
                    speed_um_s=reference.speed_um_s, speed_now_um_s=profile.measure.speed_um_s
                )
            ]
        )
    return measuring_profile(profile)


def _replaced(account: ToolAccount, z_um: float) -> list[Diagnostic]:
    """Return a warning if the tool has machined since the reference that one at `z_um` replaces."""
    before = account.reference
    if before is None or not account.since:
        return []
    return [
        failures.reference_replaced(
            label=account.label,
            z_um=length(z_um),
            before_um=length(before.z_um),
            run_file=before.run_file,
            worn_um=length(account.worn_um),
        )
    ]


_NOT_KEPT = failures.reference_not_kept()


def _reference_of(
    account: ToolAccount, ledger: Ledger | None, identity: ToolIdentity, plan: Plan
) -> ReferenceTouched:
    """Return the tool's reference. Raises PreconditionError E8041 if it has none, E8056 if it was replaced since."""
    if account.reference is not None:
        return account.reference
    if account.replaced_by:
        raise failures.tool_was_replaced(
            label=account.label, replaced_by=account.replaced_by, reference_command=reference_command(plan)
        )
    if ledger is None:
        raise failures.reference_on_fresh_machine()
    touch, where = f"`{reference_command(plan)}`", plan.where
    elsewhere = sorted({line.serial for line in ledger.lines} - {identity.serial})
    if identity.is_new:
        others = f" The job ledger {ledger.path} tells of {', '.join(elsewhere)}." if elsewhere else ""
        raise failures.reference_on_new_bench(bench_file=where.bench_file, others=others, touch=touch)
    tool = "the tool" if account.label == NAMELESS else account.label
    machine = (
        identity.serial
        if where.bench_file is None
        else f"{identity.serial}, the bench of {where.bench_file},"
    )
    others = f"; it tells of {', '.join(elsewhere)}" if elsewhere else ""
    raise failures.reference_missing(
        tool=tool, machine=machine, ledger=ledger.path, others=others, touch=touch
    )


def _aged(reference: ReferenceTouched, account: ToolAccount, now: Now) -> Reference:
    """Return the reference with its age; infinity if that is unknown."""
    age_s = now.since_s(account.reference_utc_s, account.reference_bench_s)
    return Reference(**shared(Reference, reference), age_s=age_s)
