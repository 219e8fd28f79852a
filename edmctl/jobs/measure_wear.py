"""`measure-wear`: touch the reference pad, or measure wear, depth and feed against that reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.connected_machine import Now, with_home
from edmctl.jobs.drift_choice import choose_drift
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
from edmctl.jobs.run_context import RunContext
from edmctl.jobs.runs.opening import command_to_go_on
from edmctl.jobs.surroundings import Warn
from edmctl.planning.measuring import move_time_s, park_to_pad_um, reading_time_s, touch_time_s
from edmctl.procedures.job import Job, job_of
from edmctl.procedures.measure_wear import (
    LEAST_TOUCHES,
    Bottom,
    Reference,
    measure_wear,
    refuse_drift,
    touch_pad,
)
from edmctl.procedures.monitoring.drift import counted_pause_s
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.profile.model import Profile
from edmctl.record.ledger import (
    UNFINISHED,
    Ledger,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
    WearMeasured,
)
from edmctl.record.tool_account import MachineHistory, ToolAccount, history_of
from edmctl.results.measurements import WearResult
from edmctl.wording import length

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


TOUCHES_LIKE = "cu270"
"""The shipped profile by which a tool without any run is touched if none is named."""


def measuring_profile(profile: Profile, speed_um_s: float = math.nan) -> Profile:
    """Return the recipe with enough touches of every Z, and with the speed of the reference, if given."""
    measure = profile.measure
    changes: dict[str, object] = {"touches": max(LEAST_TOUCHES, measure.touches)}
    if not math.isnan(speed_um_s):
        changes["speed_um_s"] = speed_um_s
    return profile.model_copy(update={"measure": measure.model_copy(update=changes)})


def wear_forecast(plan: Plan, *, reference: bool) -> dict[str, Any]:
    """Return readings, touches, speed and duration."""
    profile, setup = measuring_profile(plan.loaded.profile), plan.setup
    time_s = touch_time_s(profile, setup)
    if not reference:
        deep_um = profile.approach.offset_um + plan.forecast.feed_um
        moves_s = 2.0 * move_time_s(max(profile.measure.site_dx_um, park_to_pad_um(setup)), setup)
        readings_s = reading_time_s(profile, deep_um) + reading_time_s(profile, profile.approach.offset_um)
        time_s += moves_s + readings_s
    return {
        "readings": ["Z1"] if reference else ["Z3", "Z2", "Z3"],
        "touches": profile.measure.touches,
        "speed_um_s": profile.measure.speed_um_s,
        "time_s": time_s,
    }


@dataclass(slots=True)
class WearRun:
    """A request for a reference touch, or for a measurement against the reference at the hole `site`."""

    plan: Plan
    site: str | None
    is_reference: bool
    name: str = "measure-wear"
    pulses: bool = False

    def __post_init__(self) -> None:
        """Raise UsageError E2062 for a new tool that is to be measured against its reference."""
        if self.plan.new_tool and not self.is_reference:
            raise failures.new_tool_without_reference()

    @property
    def kind(self) -> str:
        """Kind of procedure in the run file."""
        return "wear reference" if self.is_reference else "measure-wear"

    def prepare(self, run: RunContext) -> ReferenceStage | WearStage:
        """Return what is touched on the connected machine. Raises what `look` raises."""
        identity = tool_identity(run.bench)
        known = self.look(run.plan, identity, run.ledger, run.warn)
        run.plan, where = known.plan, known.plan.where
        if known.reference is not None:
            run.drift = choose_drift(
                run.plan.surroundings.environ, run.plan.setup, identity.serial, lasting=where.lasting
            )
            run.warn(run.drift.warnings)
        temperature_c = run.bench.machine.status().temperature_c
        job = with_home(job_of(known.profile, run.plan.setup, (), run.actuator), run.history, run.bench.now)
        if known.reference is None:
            return ReferenceStage(run, job, known.account, temperature_c)
        reference = replace(known.reference, drift_um_per_s=run.drift.touch_um_per_s)
        return WearStage(run, job, known.account, temperature_c, reference, known.bottom)

    def look(self, plan: Plan, identity: ToolIdentity, ledger: Ledger | None, warn: Warn) -> KnownTool:
        """Return the ledger's knowledge of the tool, and the recipe of the touches.

        Without a profile it is the recipe of the run that made the hole, else of the last run with the tool.

        Raises PreconditionError: E8041 no reference, E8045 no such hole, E8046 a hole too narrow for the tool,
        E8048 a tool whose job was killed, E8056 a tool that was replaced since its reference, E8059 a reference
        under another setup, E8063 a run with an unknown recipe.
        """
        history = history_of(ledger.lines if ledger else (), identity.serial)
        account = account_of(plan, identity, history)
        folder = ledger.path.parent if ledger is not None else Path()
        if self.is_reference:
            if setup_differences(account.reference, plan.setup):
                account.pad_um = math.nan
            if ledger is None:
                warn([_NOT_KEPT])
            else:
                if plan.new_tool:
                    warn(left_to_finish(account.label, identity.serial, folder))
                plan = with_recipe_of(plan, folder, last_run_of(account))
            return KnownTool(plan, measuring_profile(plan.loaded.profile), account)
        reference = _reference_of(account, ledger, identity, plan)
        aged = _aged(reference, account, identity.now)
        refuse_other_setup(account, history, plan, folder)
        refuse_unknown_length(account, folder, plan)
        diameter_um = plan.loaded.profile.tool.diameter_um
        if not plan.names_tool:
            diameter_um = diameter_of(account.label, identity)
        bottom = bottom_of(self.site, history, account, diameter_um, folder)
        plan = with_recipe_of(plan, folder, bottom.run_file if bottom is not None else last_run_of(account))
        return KnownTool(plan, _at_speed_of(reference, plan, warn), account, aged, bottom)


@dataclass(frozen=True, slots=True)
class KnownTool:
    """The ledger's knowledge of a tool, and the recipe of its touches.

    plan, profile : with the recipe of an earlier run if no profile was named
    reference : None for a reference touch
    bottom : the hole to touch, if any
    """

    plan: Plan
    profile: Profile
    account: ToolAccount
    reference: Reference | None = None
    bottom: Bottom | None = None


@dataclass(slots=True, eq=False)
class ReferenceStage:
    """A reference touch on the machine; `touched` is the reading."""

    run: RunContext
    job: Job
    account: ToolAccount
    temperature_c: float
    home_um: float = math.nan
    touched: SurfaceReading | None = None

    def act(self, run: JobRun) -> None:
        """Touch the pad."""
        # A job that was killed has left the tool anywhere between here and what all of it would have cost.
        half_um = 0.5 * math.fsum(job.wear_um for job in self.account.killed)
        self.home_um = run.tally.home_um
        self.touched = touch_pad(run, "Z1", _expected_um(run, self.account) + half_um, 0.5 * half_um)
        self.run.warn(_replaced(self.account, self.touched.z_um))

    def close(self, time_s: float) -> None:
        """Write the reference into the ledger."""
        run, touched, tool = self.run, self.touched, self.account.label
        if touched is None:
            return
        reference = ReferenceTouched(
            tool=tool,
            run_file=run.file_name,
            z_um=touched.z_um,
            sd_um=touched.reading.sd_um,
            touches=touched.reading.touches,
            model_um=touched.model_um,
            speed_um_s=self.job.profile.measure.speed_um_s,
            time_s=touched.time_s,
            temperature_c=self.temperature_c,
            home_um=self.home_um,
            doubt_u_um=touched.doubt_u_um,
            truth={"tool_wear_um": run.bench.virtual.tool_wear_um} if run.bench.virtual else None,
            **reference_setup(run.plan.setup),
        )
        changed = [ToolChanged(tool)] if run.plan.new_tool else []
        run.write_down(*changed, reference, RunEnded(run.file_name, "done", time_s))

    def result(self) -> Mapping[str, object] | None:
        """Return the reading, and whose it is."""
        if self.touched is None:
            return None
        reading = self.touched.reading
        return {
            "machine": self.run.bench.serial,
            "tool": self.account.label,
            "dielectric_c": self.temperature_c,
            "reference": {
                "z1_um": reading.mean_um,
                "sd_um": reading.sd_um,
                "touches": reading.touches,
                "z1_model_um": self.touched.model_um,
            },
        }


@dataclass(slots=True, eq=False)
class WearStage:
    """A measurement of wear on the machine; `found` is its result."""

    run: RunContext
    job: Job
    account: ToolAccount
    temperature_c: float
    reference: Reference
    bottom: Bottom | None
    home_um: float = math.nan
    found: WearResult | None = None

    def act(self, run: JobRun) -> None:
        """Touch pad, hole and pad."""
        self.home_um, expected_um = run.tally.home_um, _expected_um(run, self.account)
        age_s = counted_pause_s(replace(run.job, pause_s=self.reference.age_s))
        self.found = measure_wear(run, replace(self.reference, age_s=age_s), expected_um, self.bottom)
        refuse_drift(run, self.found)
        self._compare(self.found)

    def close(self, time_s: float) -> None:
        """Write the wear into the ledger."""
        run, found = self.run, self.found
        if found is None:
            return
        measured = WearMeasured(
            self.account.label,
            run.file_name,
            found.z3_after_um,
            found.wear_um,
            found.wear_u95_um,
            self.home_um,
        )
        run.write_down(measured, RunEnded(run.file_name, "done", time_s))

    def result(self) -> Mapping[str, object] | None:
        """Return the measured values, and the ledger's wear of the tool."""
        if self.found is None:
            return None
        return {
            "machine": self.run.bench.serial,
            "tool": self.account.label,
            "dielectric_c": self.temperature_c,
            "site": asdict(self.bottom) if self.bottom else None,
            **asdict(self.found),
            "ledger": {"wear_um": self.account.worn_um, "wear_u95_um": self.account.worn_u95_um},
            "tool_wear_total_um": self.total_um,
            "truth": self.truth,
        }

    @property
    def total_um(self) -> float:
        """Total wear since the tool was new; NaN before it is measured."""
        return math.nan if self.found is None else self.account.lost_before_um + self.found.wear_um

    @property
    def truth(self) -> dict[str, float] | None:
        """Wear since the reference, depth and feed of a virtual bench; None on any other machine."""
        virtual, bottom = self.run.bench.virtual, self.bottom
        if virtual is None:
            return None
        before = self.account.reference.truth if self.account.reference else None
        wear_um = virtual.tool_wear_um - before["tool_wear_um"] if before else math.nan
        depth_um, holes = math.nan, virtual.truth()
        if bottom is not None and holes:
            nearest = min(holes, key=lambda h: math.hypot(h.x_um - bottom.x_um, h.y_um - bottom.y_um))
            depth_um = nearest.depth_um
        return {"wear_um": wear_um, "depth_um": depth_um, "feed_um": depth_um + wear_um}

    def _compare(self, found: WearResult) -> None:
        """Warn if the touches and the sum of the sites do not agree: something happened that no job knows of."""
        account = self.account
        off_um, u95_um = found.wear_um - account.worn_um, math.hypot(found.wear_u95_um, account.worn_u95_um)
        if abs(off_um) <= u95_um:
            return
        self.run.warn(
            [
                failures.tool_shorter_than_expected(
                    wear_um=length(found.wear_um), worn_um=length(account.worn_um), u95_um=length(u95_um)
                )
            ]
        )


def _expected_um(run: JobRun, account: ToolAccount) -> float:
    """Return the displacement where the tool should touch the pad."""
    known = not math.isnan(account.pad_um)
    return run.tally.home_um + (account.pad_um if known else run.profile.approach.offset_um)


def _at_speed_of(reference: ReferenceTouched, plan: Plan, warn: Warn) -> Profile:
    """Touch as slowly as the reference was touched, so that creep enters both alike; a named profile decides."""
    profile = plan.loaded.profile
    if not plan.names_tool:
        return measuring_profile(profile, reference.speed_um_s)
    if profile.measure.speed_um_s != reference.speed_um_s:
        warn(
            [
                failures.reference_at_another_speed(
                    speed_um_s=reference.speed_um_s, speed_um_s_2=profile.measure.speed_um_s
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
            z_um_2=length(before.z_um),
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
    return Reference(
        z_um=reference.z_um,
        sd_um=reference.sd_um,
        touches=reference.touches,
        model_um=reference.model_um,
        age_s=now.since_s(account.reference_utc_s, account.reference_bench_s),
        doubt_u_um=reference.doubt_u_um,
        home_um=reference.home_um,
    )
