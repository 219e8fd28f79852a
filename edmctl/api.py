"""The Python API: the same jobs as those of the command line, for notebooks, studies and services.

    import edmctl

    with edmctl.connect("sim:", seed=1) as machine:
        report = machine.machine("cu270", overrides={"target.depth_um": 20})
    report.sites[0].depth_um

Nothing here looks at a terminal, at signals or at the environment, and every call may be made in any thread.
Names of `edmctl` itself are loaded when they are used.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Self

from edmctl.jobs.checking import check
from edmctl.jobs.job import carry_out
from edmctl.jobs.plan import SIMULATOR, JobRequest, where_is
from edmctl.jobs.resume.selection import name_of_resumed
from edmctl.jobs.run_header import name_run
from edmctl.jobs.simulate.seeds import seed_to_use
from edmctl.jobs.surroundings import Surroundings
from edmctl.toml_text import toml_value

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from os import PathLike
    from types import TracebackType

    from edmctl.errors import Diagnostic
    from edmctl.forecasts.forecast import Forecast
    from edmctl.jobs.job import Report
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedure_command import Procedure, ProcedureReport
    from edmctl.jobs.run_header import RunName
    from edmctl.machine.stop import StopRequest
    from edmctl.record.reader import RunFile
    from edmctl.results.progress import Observer, Progress
    from edmctl.rules.load import LoadedProfile

    Overrides = Mapping[str, object] | Sequence[str]
    File = str | PathLike[str]


class Unobserved:
    """An observer that nobody looks at."""

    def progress(self, p: Progress) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""


class Machine:
    """A machine by the name of its port, as `connect` returns it.

    Each call is a session of its own, as a command is: a fresh virtual machine (`sim:`) begins anew with every call,
    `sim:FILE` keeps its work and its tool. Expected errors of a job are in its report; what cannot begin is raised.
    """

    def __init__(self, port: str, seed: int | None, setup: Path | None, wait_s: float) -> None:
        self.port = port
        """Selector of the port."""
        self.seed = seed
        """Seed of a virtual machine that is not there yet; None takes a new one for each call."""
        self._setup = setup
        self._wait_s = wait_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is held between two calls."""

    def __repr__(self) -> str:
        return f"Machine({self.port!r}, seed={self.seed})"

    def machine(
        self,
        profile: File,
        *,
        overrides: Overrides = (),
        out: File | None = None,
        run_id: str | None = None,
        calibration: File | None = None,
        allow_model: bool = False,
        new_tool: bool = False,
        observer: Observer | None = None,
        stop: StopRequest | None = None,
        warn: Callable[[Sequence[Diagnostic]], None] | None = None,
    ) -> Report:
        """Machine a job, as `edmctl machine` does.

        `profile` is the name of a shipped profile or a TOML file, `overrides` are values by key
        (`{"target.depth_um": 20}`) or texts as `--set` takes them. `out` is the folder of the run file; without it
        none is written, and neither ledger nor journal is kept. `observer` is told progress and decisions in the
        calling thread, `warn` what is doubtful before anything moves. `stop.request(signal.SIGINT)` ends the job in
        request, from any thread.

        Raises ProfileError, UsageError, RecordError, PreconditionError, LinkLost, ProtocolMismatch or RunFileError
        where it cannot begin; the error that ended a job which had begun is `report.error`.
        """
        request = self._request(profile, overrides, calibration, allow_model=allow_model, new_tool=new_tool)
        plan = check(request, _surroundings(stop))
        name = name_run(Path(out), run_id, plan.loaded, datetime.now(UTC)) if out is not None else None
        return carry_out(plan, seed_to_use(self.seed), observer or Unobserved(), name, warn)

    def resume(
        self,
        run: str,
        *,
        out: File = "runs",
        homed: bool = False,
        restart_hole: bool = False,
        observer: Observer | None = None,
        stop: StopRequest | None = None,
        warn: Callable[[Sequence[Diagnostic]], None] | None = None,
    ) -> Report:
        """Go on with the job of a run that was interrupted: its file, or its id in `out`.

        Raises PreconditionError E8050 to E8062 where nobody knows how far it came, and what `machine` raises.
        """
        from edmctl.jobs.resume.selection import checked, find_run

        resumption = find_run(run, Path(out), homed=homed, restart_hole=restart_hole)
        plan = checked(resumption, self.port, self._wait_s, _surroundings(stop))
        name = name_of_resumed(resumption, None, datetime.now(UTC))
        return carry_out(plan, seed_to_use(self.seed), observer or Unobserved(), name, warn)

    def approach(
        self,
        profile: File,
        *,
        contact: bool = False,
        site_um: tuple[float, float] | None = None,
        overrides: Overrides = (),
        out: File = "runs",
        run_id: str | None = None,
        observer: Observer | None = None,
        stop: StopRequest | None = None,
    ) -> ProcedureReport:
        """Feed the tool to the spark gap, or with `contact` to the surface, say where it is, retract.

        Raises as `machine`; E8042 a hole is there, E8044 the tool does not reach the surface.
        """
        from edmctl.jobs.approach import Approach

        plan = check(self._request(profile, overrides), _surroundings(stop))
        return self._perform(plan, Approach(plan, site_um, contact=contact), out, run_id, observer)

    def jump_flush(
        self,
        profile: File,
        *,
        count: int = 10,
        overrides: Overrides = (),
        out: File = "runs",
        run_id: str | None = None,
        observer: Observer | None = None,
        stop: StopRequest | None = None,
    ) -> ProcedureReport:
        """Make electrode jumps beside the work, without sparks, and measure them. Raises as `machine`."""
        from edmctl.jobs.jump_flush import JUMPS_ALONE, Jumps, refuse_hurry

        request = self._request(profile, (*_texts(overrides), *JUMPS_ALONE))
        plan = check(request, _surroundings(stop))
        refuse_hurry(plan)
        return self._perform(plan, Jumps(plan, count), out, run_id, observer)

    def measure_wear(
        self,
        profile: File,
        *,
        reference: bool = False,
        site: str | None = None,
        overrides: Overrides = (),
        out: File = "runs",
        run_id: str | None = None,
        new_tool: bool = False,
        observer: Observer | None = None,
        stop: StopRequest | None = None,
    ) -> ProcedureReport:
        """Touch the pad and the last hole, and say what the tool has lost since its reference; or touch that.

        `site` names another hole of the ledger in `out`. Raises as `machine`; E8041 there is no reference, E8045 no
        such hole.
        """
        from edmctl.jobs.wear.measure import WearRun

        plan = check(self._request(profile, overrides, new_tool=new_tool), _surroundings(stop))
        return self._perform(plan, WearRun(plan, site, is_reference=reference), out, run_id, observer)

    def _request(
        self,
        profile: File,
        overrides: Overrides,
        calibration: File | None = None,
        *,
        allow_model: bool = False,
        new_tool: bool = False,
    ) -> JobRequest:
        return JobRequest(
            profile=str(profile),
            overrides=_texts(overrides),
            setup=self._setup,
            port=self.port,
            calibration=Path(calibration) if calibration is not None else None,
            allow_model=allow_model,
            wait_s=self._wait_s,
            new_tool=new_tool,
        )

    def _perform(
        self, plan: Plan, procedure: Procedure, out: File, run_id: str | None, observer: Observer | None
    ) -> ProcedureReport:
        from edmctl.jobs.procedure_command import name_of, perform

        name: RunName = name_of(plan, procedure.name, Path(out), run_id)
        seed = seed_to_use(self.seed)
        return perform(plan, procedure, name, seed, observer or Unobserved(), lambda _: None)


def connect(
    port: str = SIMULATOR, *, seed: int | None = None, setup: File | None = None, wait_s: float = 0.0
) -> Machine:
    """Return the machine at a port: `sim:`, `sim:FILE`, a serial port, `socket://HOST:PORT`, `serial:ID` or `auto`.

    `seed` makes a virtual machine that is not there yet, `setup` is the TOML file of the machine's setup, and
    `wait_s` is how long to wait for a port that somebody holds. Raises UsageError E2006 for a name of nothing.
    """
    from edmctl.profile.setup import Setup

    seed_to_use(seed)
    return Machine(where_is(port, Setup()).selector, seed, Path(setup) if setup is not None else None, wait_s)


def simulate(
    profile: File,
    seeds: Iterable[int],
    *,
    overrides: Overrides = (),
    sweep: Mapping[str, Sequence[object]] | None = None,
    setup: File | None = None,
    out: File | None = None,
) -> list[Report]:
    """Machine a job on fresh virtual machines: every combination of the sweep's values, with every seed.

    The reports come in that order: `itertools.product` of the values as they are given, the seeds innermost.
    Raises what `Machine.machine` raises, before anything runs where a profile is wrong.
    """
    texts, numbers = _texts(overrides), list(seeds)
    grid = [_texts(dict(zip(sweep or {}, values, strict=True))) for values in _values(sweep)]
    machines = [connect(seed=seed, setup=setup) for seed in numbers]
    for steps in grid:
        if machines:
            check(machines[0]._request(profile, (*texts, *steps)))
    return [
        machine.machine(profile, overrides=(*texts, *steps), out=out)
        for steps in grid
        for machine in machines
    ]


def load_profile(profile: File, *, overrides: Overrides = ()) -> LoadedProfile:
    """Load and check a profile. Raises ProfileError with every diagnostic."""
    from edmctl.rules.load import load_profile as load

    return load(str(profile), _texts(overrides))


def forecast(profile: File, *, overrides: Overrides = (), setup: File | None = None) -> Forecast:
    """Return what a job will take: time, feed, stroke, wear. Raises ProfileError."""
    from edmctl.forecasts.forecast import forecast as foretell
    from edmctl.profile.setup import load_setup
    from edmctl.rules.load import load_profile as load

    known = load_setup(Path(setup) if setup is not None else None)
    loaded = load(str(profile), _texts(overrides), setup=known)
    return foretell(loaded.profile, known, loaded.places)


def open_run(path: File) -> RunFile:
    """Open a run file to read, also one that is being written. Raises RunFileError."""
    from edmctl.record.reader import open_run as opened

    return opened(Path(path))


def _values(sweep: Mapping[str, Sequence[object]] | None) -> Iterable[tuple[object, ...]]:
    return itertools.product(*(sweep or {}).values())


def _texts(overrides: Overrides) -> tuple[str, ...]:
    """Overrides as `--set` takes them."""
    if isinstance(overrides, str):
        return (overrides,)
    if isinstance(overrides, (tuple, list)):
        return tuple(overrides)
    return tuple(f"{key}={toml_value(value)}" for key, value in overrides.items())  # type: ignore[union-attr]


def _surroundings(stop: StopRequest | None) -> Surroundings:
    surroundings = Surroundings(command=("edmctl", "(Python)"))
    return surroundings if stop is None else replace(surroundings, stop=lambda _: stop)
