"""`measure-wear`: touch the reference pad, or measure wear, depth and feed against that reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from edmctl import failures
from edmctl.dataclasses import asdict, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.corrections import choose_drift
from edmctl.jobs.plan import Plan
from edmctl.jobs.prepared_job import coordinates_in
from edmctl.jobs.procedures import Procedure, expected_pad_um, job_with_home
from edmctl.jobs.run_context import RunContext
from edmctl.jobs.runs.opening import command_to_go_on
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.tool import NAMELESS, MachineTool, ToolIdentity, reference_setup, setup_differences
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
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolAccount,
    ToolChanged,
    WearMeasured,
)
from edmctl.results.declared import shared
from edmctl.results.measurements import WearResult
from edmctl.wording import length

MOST_NAMES = 8
"""Holes that a message lists."""


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

    def look(self, plan: Plan, identity: ToolIdentity, ledger: Ledger | None, warn: Warn) -> Plan:
        """Read what the ledger has on the tool; return the plan with its recipe if no profile was named."""
        raise NotImplementedError

    def begin(self, run: RunContext) -> None:
        """Look at the connected machine and its ledger."""
        run.plan = self.look(run.plan, run.tool_identity, run.ledger, run.warn)
        self._temperature_c = run.bench.machine.status().temperature_c


class ReferenceTouch(_Touches):
    """A reference touch: Z1 of the tool in the machine."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.touched: SurfaceReading | None = None

    def look(self, plan: Plan, identity: ToolIdentity, ledger: Ledger | None, warn: Warn) -> Plan:
        tool = MachineTool(plan, identity, ledger)
        self.account = account = tool.account
        if setup_differences(account.reference, plan.setup):
            account.pad_um = math.nan
        if ledger is None:
            warn([failures.reference_not_kept()])
        elif plan.new_tool:
            warn(tool.unfinished_warnings())
        return tool.plan_with_recipe_of(tool.last_run_file)

    def carry_out(self, run: RunContext) -> None:
        """Touch the pad, and write the reference into the ledger."""
        self.begin(run)
        account, job = self.account, job_with_home(run, measuring_profile(run.plan.loaded.profile))
        with run.recording("wear reference", lambda: self.summary(run)):
            with run.armed(job) as job_run:
                # A job that was killed has left the tool anywhere between here and what all of it would have cost.
                half_um = 0.5 * math.fsum(job.wear_um for job in account.killed)
                home_um = job_run.tally.home_um
                expected_um = expected_pad_um(job_run, account) + half_um
                self.touched = touched = touch_pad(job_run, "Z1", expected_um, 0.5 * half_um)
                if account.reference is not None and account.since:
                    warning = failures.reference_replaced(
                        label=account.label,
                        z_um=length(touched.z_um),
                        before_um=length(account.reference.z_um),
                        run_file=account.reference.run_file,
                        worn_um=length(account.worn_um),
                    )
                    run.warn([warning])
            virtual = run.bench.virtual
            reference = ReferenceTouched(
                tool=account.label,
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
                truth={"tool_wear_um": virtual.tool_wear_um} if virtual else None,
                **reference_setup(run.plan.setup),
            )
            changed = [ToolChanged(account.label)] if run.plan.new_tool else []
            run.write_down(*changed, reference, RunEnded(run.file_name, "done", run.tally.time_s))

    def result(self, run: RunContext) -> Mapping[str, object] | None:
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
        """Read the tool's account, its reference and the hole to touch; return the plan with the hole's recipe."""
        tool = MachineTool(plan, identity, ledger)
        self.account = account = tool.account
        reference = _reference_of(tool)
        age_s = identity.now.since_s(account.reference_utc_s, account.reference_bench_s)
        self._reference = Reference(**shared(Reference, reference), age_s=age_s)
        tool.refuse_other_setup()
        tool.refuse_unknown_length()
        self.bottom = bottom_of(self._site, tool)
        plan = tool.plan_with_recipe_of(self.bottom.run_file if self.bottom else tool.last_run_file)
        speed_um_s = plan.loaded.profile.measure.speed_um_s
        if not plan.names_tool:  # as slowly as the reference was touched, so that creep enters both alike
            self._profile = measuring_profile(plan.loaded.profile, reference.speed_um_s)
            return plan
        if speed_um_s != reference.speed_um_s:
            speeds = {"speed_um_s": reference.speed_um_s, "speed_now_um_s": speed_um_s}
            warn([failures.reference_at_another_speed(**speeds)])
        self._profile = measuring_profile(plan.loaded.profile)
        return plan

    def carry_out(self, run: RunContext) -> None:
        """Touch pad, hole and pad, and write the wear into the ledger."""
        self.begin(run)
        plan, account = run.plan, self.account
        run.drift = choose_drift(
            plan.surroundings.environ, plan.setup, run.bench.serial, lasting=plan.where.lasting
        )
        run.warn(run.drift.warnings)
        job = job_with_home(run, self._profile)
        with run.recording(self.name, lambda: self.summary(run)):
            with run.armed(job) as job_run:
                home_um, expected_um = job_run.tally.home_um, expected_pad_um(job_run, account)
                age_s = counted_pause_s(replace(job_run.job, pause_s=self._reference.age_s))
                reference = replace(self._reference, age_s=age_s, drift_um_per_s=run.drift.touch_um_per_s)
                self.found = found = measure_wear(job_run, reference, expected_um, self.bottom)
                self.total_um = account.lost_before_um + found.wear_um
                self.truth = self._truth(run)
                refuse_drift(job_run, found)
                run.warn(_contradictions(found, account))
            wear = found.wear_um, found.wear_u95_um
            measured = WearMeasured(account.label, run.file_name, found.z3_after_um, *wear, home_um)
            run.write_down(measured, RunEnded(run.file_name, "done", run.tally.time_s))

    def result(self, run: RunContext) -> Mapping[str, object] | None:
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
    lengths = {"wear_um": found.wear_um, "worn_um": account.worn_um, "u95_um": u95_um}
    return [failures.tool_shorter_than_expected(**{name: length(um) for name, um in lengths.items()})]


def bottom_of(site: str | None, tool: MachineTool) -> Bottom | None:
    """Return the requested hole, or else the last measured hole of the tool; None without any."""
    if site is None:
        made = [hole for hole in tool.account.holes if hole.status != UNFINISHED]
        return _bottom(made[-1]) if made and not made[-1].through else None
    hole = _hole_called(site, tool.history.holes)
    if hole is None:
        names = "; ".join(
            f"{known.name} at {known.x_um:.0f},{known.y_um:.0f} of {known.run_file.removesuffix('.h5')}"
            for known in tool.history.holes[-MOST_NAMES:]
        )
        raise failures.hole_unknown(asked=site, names=names or "none")
    if hole.through:
        raise failures.hole_without_bottom(hole=hole.name)
    if math.isnan(hole.depth_um):
        run_file, remedy = tool.folder / hole.run_file, "Name another hole with --site."
        if command := command_to_go_on(run_file):
            remedy = f"Finish it with `{command}`, or n{remedy[1:]}"
        raise failures.hole_depth_unknown(hole=hole.name, run_file=run_file, remedy=remedy)
    if tool.diameter_um >= 2.0 * hole.radius_um:
        raise failures.tool_wider_than_hole(
            diameter_um=length(tool.diameter_um), hole=hole.name, radius_um=length(2.0 * hole.radius_um)
        )
    return _bottom(hole)


def _hole_called(site: str, holes: list[SiteMachined]) -> SiteMachined | None:
    """Return the last hole of that name or else of that run, or the one around that place."""
    place = coordinates_in(site)
    if place is None:
        named = [hole for hole in holes if hole.name == site]
        of_run = [hole for hole in holes if hole.run_file.removesuffix(".h5") == site.removesuffix(".h5")]
        return next(reversed(named or of_run), None)
    around = [hole for hole in holes if math.dist(place, (hole.x_um, hole.y_um)) <= hole.radius_um]
    return next(reversed(around), None)


def _bottom(hole: SiteMachined) -> Bottom:
    known = Bottom(hole.name, hole.x_um, hole.y_um, hole.depth_um, run_file=hole.run_file)
    return known if math.isnan(hole.depth_u_um) else replace(known, depth_u_um=hole.depth_u_um)


def _reference_of(tool: MachineTool) -> ReferenceTouched:
    """Return the tool's reference. Raises PreconditionError E8041 if it has none, E8056 if it was replaced since."""
    account, ledger, identity, command = tool.account, tool.ledger, tool.identity, tool.reference_command
    if account.reference is not None:
        return account.reference
    if account.replaced_by:
        raise failures.tool_was_replaced(
            label=account.label, replaced_by=account.replaced_by, reference_command=command
        )
    if ledger is None:
        raise failures.reference_on_fresh_machine()
    touch, bench_file = f"`{command}`", tool.plan.where.bench_file
    elsewhere = ", ".join(sorted({line.serial for line in ledger.lines} - {identity.serial}))
    if identity.is_new:
        others = f" The job ledger {ledger.path} tells of {elsewhere}." if elsewhere else ""
        raise failures.reference_on_new_bench(bench_file=bench_file, others=others, touch=touch)
    raise failures.reference_missing(
        tool="the tool" if account.label == NAMELESS else account.label,
        machine=identity.serial + (f", the bench of {bench_file}," if bench_file else ""),
        ledger=ledger.path,
        others=f"; it tells of {elsewhere}" if elsewhere else "",
        touch=touch,
    )
