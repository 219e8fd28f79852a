"""Requests, the machine they address, and the checked plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, PreconditionError, ProfileError
from edmctl.failures import Code
from edmctl.files import user_path
from edmctl.jobs.corrections import check_named_calibration
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.labels import PAD, PARKING
from edmctl.planning.forecast import Reached, forecast
from edmctl.planning.rules.load import LoadedProfile, load_profile
from edmctl.procedures.job import JobState
from edmctl.profile.places import Place
from edmctl.profile.read import read_source
from edmctl.profile.setup import Setup, load_setup
from edmctl.record.journal import Journal, JournalledJob
from edmctl.results.result import Forecast
from edmctl.wording import coordinates, plural

SIMULATOR = "sim:"
TOUCHES_LIKE = "cu270"
"""The shipped profile by which a tool without any run is touched if none is named."""


@dataclass(frozen=True, slots=True)
class MachineAddress:
    """A machine: the selector of its port, and how long to wait for the port.

    controller : drives a new virtual machine; empty for the profile's choice
    """

    selector: str = SIMULATOR
    wait_s: float = 0.0
    controller: str = ""

    @property
    def in_process(self) -> bool:
        """Whether it is a virtual bench in this process, whose truth is known."""
        return self.selector.startswith(SIMULATOR)

    @property
    def bench_file(self) -> Path | None:
        """File of a persistent virtual bench; None for a new one and for every other machine."""
        if not self.in_process or self.selector == SIMULATOR:
            return None
        return user_path(self.selector.removeprefix(SIMULATOR))

    @property
    def lasting(self) -> bool:
        """Whether the machine is still there after the command; a fresh virtual bench is not."""
        return self.selector != SIMULATOR

    def seed_of(self, seed: int) -> int | None:
        """Return the seed that will make the machine; None for one that is there already."""
        file = self.bench_file
        return seed if self.in_process and (file is None or not file.exists()) else None


FRESH = MachineAddress()
"""A virtual machine that is gone with the command."""


def where_is(option: str | None, setup: Setup, wait_s: float = 0.0) -> MachineAddress:
    """Return the machine of the option (or its environment variable), else of the setup, else a new virtual one."""
    if not wait_s >= 0.0:
        raise failures.wait_impossible(wait_s=wait_s)
    if option is not None and not option.strip():
        raise failures.port_empty()
    selector = option or setup.port or SIMULATOR
    if selector == SIMULATOR.rstrip(":"):
        selector = SIMULATOR
    if selector.startswith("~"):
        selector = str(user_path(selector))
    return MachineAddress(selector, wait_s)


@dataclass(frozen=True, slots=True)
class JobRequest:
    """The options of the command line, in plain values that can be sent to worker processes."""

    profile: str | None
    overrides: tuple[str, ...]
    setup: Path | None
    port: str | None
    calibration: Path | None = None
    allow_model: bool = False
    wait_s: float = 0.0
    new_tool: bool = False


@dataclass(frozen=True, slots=True)
class Resumption:
    """An interrupted run, by its journal at `path`.

    `homed`: the stages are confirmed to be where the restarted controller counts them. `restart_hole`: the
    interrupted hole is made from the start.
    """

    path: Path
    journal: Journal
    state: JobState
    homed: bool
    restart_hole: bool = False

    @property
    def job(self) -> JournalledJob:
        """Which job it was."""
        return self.journal.job

    @property
    def run_files(self) -> tuple[str, ...]:
        """Names of the run files of this job so far."""
        return tuple(f"{run_id}.h5" for run_id in self.job.family)

    def request(self, port: str | None, wait_s: float) -> JobRequest:
        """Return the request that the job came from, on the machine that is named now."""
        job = self.job
        return JobRequest(
            profile=job.profile,
            overrides=job.overrides,
            setup=Path(job.setup) if job.setup else None,
            port=port,
            calibration=Path(job.calibration) if job.calibration else None,
            allow_model=job.allow_model,
            wait_s=wait_s,
        )

    def changed(self, what: str, which: str, how: str) -> PreconditionError:
        """Return the error E8053 of a profile or setup that is not the run's own."""
        remedy = "It has cut nothing: start a new job, without --resume."
        if self.state.has_cut:
            remedy = f"Put back the {what} as it was on {self.job.start[:10]}; the run file holds it. "
            remedy += "Machine it at another place or on new work."
        return failures.job_differs(what=what, which=which, how=how, run_id=self.job.run_id, remedy=remedy)

    def refuse_other_setup(self, setup: Setup) -> None:
        """Raise PreconditionError E8053 if the setup differs from that of the interrupted run."""
        if setup.sha256 != self.job.setup_sha256:
            now = "" if setup.file is None else f"; {setup.file} is used now"
            raise self.changed("setup", self.job.setup or "of the stock machine", f"has changed{now}")

    @property
    def remaining(self) -> list[str]:
        """Names of the holes that are not finished, or of the channel."""
        done = {site["name"] for site in self.state.done}
        return [name for name, *_ in self.job.places if name not in done]

    def as_mapping(self) -> dict[str, object]:
        """Return the progress for scripts; depth and wear are estimates of the interrupted hole."""
        state = self.state
        return {
            "run_id": self.job.run_id,
            "journal": str(self.path),
            "done": [str(site["name"]) for site in state.done],
            "left": self.remaining,
            "site": state.site if state.begun else None,
            "depth_um": state.depth_um if state.begun else None,
            "wear_um": state.wear_um if state.begun else None,
            "time_s": state.time_s,
        }

    def message(self) -> str:
        """Return the same for people."""
        state = self.state
        begun = f"; {state.site} was interrupted at about {state.depth_um:.1f} µm" if state.begun else ""
        if state.channel:
            return f"{self.job.run_id} machines a channel{begun}."
        holes = plural(len(self.job.places), "hole")
        left = f"Left: {', '.join(self.remaining)}" if self.remaining else "Nothing is left"
        return f"{self.job.run_id} has finished {len(state.done)} of {holes}{begun}. {left}."


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked request.

    `new_tool` means that the electrode was changed. Without `names_tool` the machine's tool is used as it is, and
    `recipe_of` is the run file whose recipe is used, if any.
    """

    request: JobRequest
    where: MachineAddress
    loaded: LoadedProfile
    setup: Setup
    setup_text: str
    new_tool: bool = False
    names_tool: bool = True
    resumed: Resumption | None = None
    surroundings: Surroundings = NONE
    recipe_of: str = ""

    @property
    def simulated(self) -> bool | None:
        """Whether the machine is a virtual one; None if that is known only after connecting."""
        return True if self.where.in_process else None

    @property
    def forecast(self) -> Forecast:
        """The forecast of the whole job."""
        return self.loaded.forecast

    def forecast_remaining(self) -> Forecast | None:
        """Return the forecast of the holes that remain, with the interrupted one; None if none remains."""
        if self.resumed is None:
            return self.forecast
        if not self.resumed.remaining:
            return None
        state = self.resumed.state
        places = [place for place in self.loaded.places if place.name in self.resumed.remaining]
        is_begun = state.begun and not self.resumed.restart_hole
        reached = Reached(state.site, state.depth_um) if is_begun else None
        return forecast(self.loaded.profile, self.setup, places, reached)


def check(request: JobRequest, surroundings: Surroundings = NONE) -> Plan:
    """Load and check everything the request names, for the program in `surroundings`.

    Raises ProfileError, RecordError, UsageError, LinkLost, PreconditionError.
    """
    if request.profile is None:
        raise failures.no_profile_named()
    setup = load_setup(request.setup)
    where = where_is(request.port, setup, request.wait_s)
    loaded = load_profile(request.profile, request.overrides, setup=setup)
    if where.in_process:
        _refuse_beside_virtual_workpiece(setup, loaded.places)
    check_named_calibration(
        request.calibration,
        surroundings.environ,
        setup,
        loaded.profile,
        allow_model=request.allow_model,
    )
    text = read_source(request.setup).text if request.setup else ""
    return Plan(request, where, loaded, setup, text, request.new_tool, surroundings=surroundings)


def under(plan: Plan, setup: Setup) -> Plan:
    """Return the plan checked for another setup, on the same machine. Raises as `check`."""
    checked = check(replace(plan.request, setup=setup.file), plan.surroundings)
    checked = replace(checked, where=plan.where, names_tool=plan.names_tool)
    return checked if plan.resumed is None else with_resumed(checked, plan.resumed)


def with_resumed(plan: Plan, resumed: Resumption) -> Plan:
    """Return the plan of a resumed job, without the warning of its time limit if the rest is within it."""
    plan = replace(plan, resumed=resumed)
    remaining, limit_s = plan.forecast_remaining(), plan.loaded.profile.limits.max_time_s
    if remaining is not None and remaining.time_s > limit_s:
        return plan
    warnings = tuple(warning for warning in plan.loaded.warnings if warning.code != Code.TIME_LIMIT)
    return replace(plan, loaded=replace(plan.loaded, warnings=warnings))


def _refuse_beside_virtual_workpiece(setup: Setup, places: Sequence[Place]) -> None:
    """Raise ProfileError E3140 if parking place, pad or holes do not fit the workpiece of the virtual machine.

    That is the workpiece of the stock machine, independent of the setup.
    """
    stage, (edge,) = setup.stage, Setup().workpiece_limits()
    for name, x_um, y_um in (
        (PARKING, stage.park_x_um, stage.park_y_um),
        (PAD, stage.reference_x_um, stage.reference_y_um),
        *((place.name, place.x_um, place.y_um) for place in places),
    ):
        is_over = edge.beyond_um(x_um, y_um) <= 0.0
        if is_over == (name == PARKING):
            side = "over" if is_over else "beside"
            message = f"{name} at {coordinates(x_um, y_um)} is {side} the workpiece of the virtual machine"
            message += f", which begins at x = {-edge.um:g} µm"
            hint = "correct it; the virtual machine has this workpiece with every setup"
            raise ProfileError((Diagnostic(Code.OUT_OF_REACH, message, hint),))
