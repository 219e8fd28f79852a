"""The options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from edmctl.cli import completion

ProfileOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--profile",
        "-p",
        metavar="NAME|FILE",
        envvar="EDMCTL_PROFILE",
        help="The job: a TOML file, or the name of a shipped profile.",
        autocompletion=completion.profiles,
    ),
]
SetOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override one profile value, e.g. servo.reference=0.82. Repeatable.",
        autocompletion=completion.keys,
    ),
]
SetupOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--setup", metavar="FILE", help="Settings of the machine itself (TOML); defaults without."),
]
PortOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--port",
        metavar="SELECTOR",
        envvar="EDMCTL_PORT",
        help="Which machine: sim: (as without), sim:FILE (a virtual one that is kept there), a serial port, "
        "socket://HOST:PORT, serial:ID, auto.",
        autocompletion=completion.ports,
    ),
]
WaitOption: TypeAlias = Annotated[
    float,
    typer.Option(
        "--wait", metavar="SECONDS", min=0.0, help="Wait so long for a port that is held or absent."
    ),
]
SeedOption: TypeAlias = Annotated[
    int | None,
    typer.Option("--seed", metavar="N", help="Seed of the simulator; random without."),
]
CalibrationOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="Calibration of the actuator; EDMCTL_CALIBRATION, the setup's, or the machine's own without.",
    ),
]
AllowModelOption: TypeAlias = Annotated[
    bool,
    typer.Option("--allow-model", help="Without a displacement sensor, go by the calibrated actuator alone."),
]
NewToolOption: TypeAlias = Annotated[
    bool,
    typer.Option("--new-tool", help="The electrode was changed: forget length and wear of the one before."),
]
OutOption: TypeAlias = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Folder of run files and job ledger.")
]
RunIdOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--run-id", metavar="ID", help="Name of the run file; made from profile and time without."),
]
DryRunOption: TypeAlias = Annotated[
    bool, typer.Option("--dry-run", help="Check and forecast the job; touch nothing.")
]
FileArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="A run file, also an unfinished one (.h5.partial), or the id of a run in runs/.",
        autocompletion=completion.runs,
    ),
]
JsonOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--json", help="Write one JSON object to stdout, also on failure; a single line in files and pipes."
    ),
]
EventsOption: TypeAlias = Annotated[bool, typer.Option("--events", help="Progress as JSON lines on stderr.")]
QuietOption: TypeAlias = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]
DebugOption: TypeAlias = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
