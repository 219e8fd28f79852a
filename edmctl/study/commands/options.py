"""Arguments and options that the commands of `edmctl study` share."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import NewToolOption, PortOption, WaitOption
from edmctl.cli.outcome import Outcome
from edmctl.dataclasses import dataclass
from edmctl.profile.folders import find_profile, find_study

if TYPE_CHECKING:
    from edmctl.jobs.plan import MachineAddress
    from edmctl.study.folder import StudyFolder
    from edmctl.study.study_file import StudySource

StudyArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help="A study file (TOML), or the name of a shipped study.",
        autocompletion=completion.studies,
    ),
]
FolderArgument: TypeAlias = Annotated[
    Path, typer.Argument(metavar="DIR", help="The folder of a study, as `edmctl study run` made it.")
]


def _run_number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise typer.BadParameter(f"{text!r} is no number of a run, such as 3")
    return int(text)


RunNumberArgument: TypeAlias = Annotated[
    int, typer.Argument(metavar="RUN", help="Number of a run.", parser=_run_number)
]
WorkersOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        max=1024,
        help="Processes side by side. Default: as many as processors.",
    ),
]
DaskOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Make the runs on a dask cluster whose scheduler is there."
    ),
]
HomedOption: TypeAlias = Annotated[
    bool,
    typer.Option("--homed", help="Confirm that the stages are where the restarted controller counts them."),
]
YesOption: TypeAlias = Annotated[
    bool, typer.Option("--yes", help="Approve every run that the study wants approved.")
]


@dataclass(frozen=True, slots=True)
class Making:
    """How runs are made: on the machine at `where`, or on virtual ones by so many workers or a cluster."""

    workers: WorkersOption = None
    dask: DaskOption = None
    port: PortOption = None
    wait: WaitOption = 0.0
    new_tool: NewToolOption = False
    homed: HomedOption = False
    yes: YesOption = False

    def refuse(self, setup: Path | None, *, has_machine: bool) -> None:
        """Refuse options that do not go together, before anything is made. Raises UsageError E2103, E2108."""
        if self.where(setup).lasting:
            if self.workers is not None or self.dask is not None:
                raise failures.workers_on_one_machine()
            if not has_machine:
                from edmctl.study.on_machine import without_machine

                raise without_machine()
        elif self.new_tool or self.homed:
            raise failures.machine_options_without_machine()
        if self.dask is not None and self.workers is not None:
            raise failures.workers_with_dask()

    def where(self, setup: Path | None) -> "MachineAddress":
        """Return the machine that is named; a fresh virtual one where none is."""
        from edmctl.jobs.plan import where_is
        from edmctl.profile.setup import load_setup

        return where_is(self.port, load_setup(setup), self.wait)


CHECKS_EVERY_S = 2.0
"""A long plan says so often how far it is."""


def checks_told(note: "Callable[[str], None]") -> "Callable[[int, int], None]":
    """Return an observer of a plan that says now and then how many settings are checked."""
    due_s = time.monotonic() + CHECKS_EVERY_S

    def observe(done: int, total: int) -> None:
        nonlocal due_s
        if time.monotonic() >= due_s and done < total:
            due_s = time.monotonic() + CHECKS_EVERY_S
            note(f"checked {done} of {total} settings")

    return observe


def study_source(outcome: "Outcome", file: str) -> "StudySource":
    """Read a study file, and report which one and which profile it uses. Raises UsageError E2001, E2100."""
    from edmctl.study.planning import base_request
    from edmctl.study.study_file import read_study

    source = read_study(find_study(file))
    profile = base_request(source).profile
    assert profile is not None
    outcome.uses(study=source.path, profile=find_profile(profile))
    return source


def opened(folder: Path) -> "StudyFolder":
    """Open a study's folder. Raises UsageError E2101, PreconditionError E8202."""
    from edmctl.study.folder import open_folder

    return open_folder(folder)
