"""Arguments and options that the commands of `edmctl study` share."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from edmctl.cli import completion

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.jobs.study.folder import StudyFolder

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
RunNumberArgument: TypeAlias = Annotated[int, typer.Argument(metavar="RUN", help="Number of a run.", min=1)]
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
ShardOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--shard", metavar="K/N", help="Make part K of N alone; others make the rest on other computers."
    ),
]
DaskOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Make the runs on a dask cluster whose scheduler is there."
    ),
]
HomedOption: TypeAlias = Annotated[
    bool, typer.Option("--homed", help="The stages were homed since the controller was switched on.")
]
YesOption: TypeAlias = Annotated[
    bool, typer.Option("--yes", help="Approve every run that the study wants approved.")
]


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


def opened(folder: Path) -> "StudyFolder":
    """Open a study's folder. Raises UsageError E2101, PreconditionError E8202."""
    from edmctl.jobs.study.folder import open_folder

    return open_folder(folder)
