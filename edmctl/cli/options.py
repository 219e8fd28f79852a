"""The options that several commands share, and the way from a function to a command that has them.

A parameter whose type is a group of options (a dataclass) stands for all of them, in its place.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args

import typer

from edmctl.cli import completion
from edmctl.cli.outcome import Outcome, Output, mutter, run_command
from edmctl.cli.signals import shell
from edmctl.dataclasses import dataclass
from edmctl.errors import ExitCode
from edmctl.files import user_path
from edmctl.profile.folders import SETUP_VARIABLE

if TYPE_CHECKING:
    from edmctl.jobs.plan import Plan


def option(usage: str, help: str, **more: Any) -> Any:
    """Return an option as help shows it: `--out -o FILE` has two names and takes a value."""
    words = usage.split(" ")
    names = [word for word in words if word.startswith("-")]
    return typer.Option(*names, metavar=" ".join(words[len(names) :]) or None, help=help, **more)


def argument(metavar: str, help: str, **more: Any) -> Any:
    """Return an argument as help shows it."""
    return typer.Argument(metavar=metavar, help=help, show_default=False, **more)


ProfileOption: TypeAlias = Annotated[
    str | None,
    option(
        "--profile -p NAME|FILE",
        "The job: a TOML file, or the name of a shipped profile.",
        envvar="EDMCTL_PROFILE",
        autocompletion=completion.profiles,
    ),
]
SetOption: TypeAlias = Annotated[
    list[str] | None,
    option(
        "--set KEY=VALUE",
        "Override one profile value, e.g. servo.reference=0.82. Repeatable.",
        autocompletion=completion.keys,
    ),
]
SetupOption: TypeAlias = Annotated[
    Path | None,
    option(
        "--setup FILE",
        "Settings of the machine itself (TOML). Default: setup-SERIAL.toml in the configuration folder.",
        envvar=SETUP_VARIABLE,
    ),
]
PortOption: TypeAlias = Annotated[
    str | None,
    option(
        "--port SELECTOR",
        "Which machine: sim: (default), sim:FILE (a virtual one that is kept there), a serial port, "
        "socket://HOST:PORT, serial:ID, auto.",
        envvar="EDMCTL_PORT",
        autocompletion=completion.ports,
    ),
]
WaitOption: TypeAlias = Annotated[
    float, option("--wait SECONDS", "Longest wait for a port that is held or absent.", min=0.0)
]
SeedOption: TypeAlias = Annotated[int | None, option("--seed N", "Seed of the simulator. Default: random.")]
ControllerOption: TypeAlias = Annotated[
    str | None,
    option(
        "--controller firmware|firmware-float|stm32",
        "What drives a new virtual machine, as sim.controller says. Default: firmware.",
    ),
]
CalibrationOption: TypeAlias = Annotated[
    Path | None,
    option(
        "--calibration FILE",
        "Calibration of the actuator. Default: EDMCTL_CALIBRATION, the setup's, or the machine's own.",
    ),
]
AllowModelOption: TypeAlias = Annotated[
    bool, option("--allow-model", "Without a displacement sensor, go by the calibrated actuator alone.")
]
NewToolOption: TypeAlias = Annotated[
    bool, option("--new-tool", "The electrode was changed: begin its length and wear anew.")
]
OutOption: TypeAlias = Annotated[Path, option("--out DIR", "Folder of run files and job ledger.")]
RunIdOption: TypeAlias = Annotated[
    str | None, option("--run-id ID", "Name of the run file. Default: profile and time.")
]
DryRunOption: TypeAlias = Annotated[bool, option("--dry-run", "Check and forecast the job; touch nothing.")]
RunArgument: TypeAlias = Annotated[
    Path,
    argument(
        "RUN",
        "A run file, also an unfinished one (.h5.partial), or the id of a run in runs/.",
        autocompletion=completion.runs,
    ),
]
_JSON = "Write one JSON object to stdout, also on failure; a single line in files and pipes."
_OUTPUT = {
    "json": Annotated[bool, option("--json", _JSON)],
    "events": Annotated[bool, option("--events", "Progress as JSON lines on stderr.")],
    "quiet": Annotated[bool, option("--quiet -q", "No progress.")],
    "debug": Annotated[bool, option("--debug", "Show the traceback of an error.")],
}
RESULT, NOTES, PROGRESS = ("json", "debug"), ("json", "quiet", "debug"), tuple(_OUTPUT)
"""What a command leaves: a result alone, words on the way as well, or all of its progress."""


def controlled_by(controller: str | None) -> tuple[str, ...]:
    """Return the change of the profile that --controller stands for. Raises UsageError E2049 for no controller."""
    if controller is None:
        return ()
    from edmctl.jobs.connect import known_controller

    return (f"sim.controller={known_controller(controller)}",)


@dataclass(frozen=True, slots=True)
class JobOptions:
    """What to do, on which machine, by which calibration."""

    profile: ProfileOption = None
    overrides: SetOption = None
    setup: SetupOption = None
    port: PortOption = None
    wait: WaitOption = 0.0
    seed: SeedOption = None
    controller: ControllerOption = None
    calibration: CalibrationOption = None
    allow_model: AllowModelOption = False

    def plan(
        self,
        outcome: Outcome,
        changes: Sequence[str] = (),
        *,
        like: str | None = None,
        new_tool: bool = False,
    ) -> "Plan":
        """Check what is asked for, with `changes` to the profile; `like` is the profile where none is named.

        Raises ProfileError, RecordError, UsageError, LinkLost, PreconditionError.
        """
        from edmctl.jobs.connect import controller_warning
        from edmctl.jobs.plan import JobRequest, check
        from edmctl.jobs.sweep import seed_to_use

        seed_to_use(self.seed)  # refused before a dry run too
        request = JobRequest(
            profile=self.profile or like,
            overrides=(*(self.overrides or ()), *changes, *controlled_by(self.controller)),
            setup=self.setup,
            port=self.port,
            calibration=self.calibration,
            allow_model=self.allow_model,
            wait_s=self.wait,
            new_tool=new_tool,
        )
        plan = dataclasses.replace(check(request, shell()), names_tool=self.profile is not None)
        outcome.simulated = plan.simulated
        outcome.uses(profile=plan.loaded.path if self.profile else None, setup=plan.setup.file)
        outcome.warn([*plan.loaded.warnings, *controller_warning(plan.where, self.controller)])
        return plan


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Where the run goes, unless it is only planned."""

    out: OutOption = Path("runs")
    run_id: RunIdOption = None
    dry_run: DryRunOption = False


def command(name: str, leaves: Sequence[str] = RESULT) -> Callable[[Callable[..., None]], Callable[..., int]]:
    """Make a command of a function whose first parameter is its `Outcome`: options in, exit code out."""

    def decorate(body: Callable[..., None]) -> Callable[..., int]:
        groups: dict[str, type[Any]] = {}
        parameters: list[inspect.Parameter] = []
        for own in list(inspect.signature(body).parameters.values())[1:]:
            if isinstance(own.annotation, type) and dataclasses.is_dataclass(own.annotation):
                groups[own.name] = own.annotation
                fields = dataclasses.fields(own.annotation)
                parameters += [_parameter(field.name, field.type, field.default) for field in fields]
            else:
                parameters.append(_parameter(own.name, own.annotation, own.default))
        parameters += [_parameter(key, _OUTPUT[key], default=False) for key in leaves]

        @functools.wraps(body)
        def run(**given: Any) -> int:
            output = Output(name, **{key: given.pop(key) for key in leaves})
            for group, kind in groups.items():
                given[group] = kind(
                    **{field.name: given.pop(field.name) for field in dataclasses.fields(kind)}
                )
            return run_command(output, lambda outcome: body(outcome, **given))

        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate


def command_group(text: str) -> typer.Typer:
    """Return a group for commands; called without one it writes its help to stderr and exits with code 2."""
    group = typer.Typer(help=text, rich_markup_mode=None, add_completion=False, invoke_without_command=True)

    @group.callback()
    def show_help(context: typer.Context) -> None:
        if context.invoked_subcommand is None:
            mutter(context.get_help() + "\n")
            raise typer.Exit(ExitCode.USAGE)

    return group


def options_given(context: typer.Context) -> dict[str, str]:
    """Return the options of a command line by the names of their parameters; environment variables do not count."""
    return {
        parameter.name or "": parameter.opts[0]
        for parameter in context.command.params
        if getattr(context.get_parameter_source(parameter.name or ""), "name", "") == "COMMANDLINE"
    }


def with_options_of(other: Callable[..., int]) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Give a function that takes a context the options and the help of a command."""

    def decorate(function: Callable[..., int]) -> Callable[..., int]:
        first = next(iter(inspect.signature(function).parameters.values()))
        rest = inspect.signature(other).parameters.values()
        function.__signature__ = inspect.Signature([first, *rest])  # type: ignore[attr-defined]
        function.__annotations__ = {p.name: p.annotation for p in (first, *rest)}
        function.__doc__ = other.__doc__
        return function

    return decorate


def _takes_path(annotation: Any) -> bool:
    return annotation is Path or any(map(_takes_path, get_args(annotation)))


def _parameter(name: str, annotation: Any, default: object) -> inspect.Parameter:
    """Return the parameter of an option; every path is read by `user_path`."""
    if _takes_path(annotation):
        annotation.__metadata__[0].parser = user_path
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
