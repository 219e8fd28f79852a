"""`edmctl firmware build`: make the library that `--controller firmware` uses, and say what by."""

from typing import Annotated

import typer

from edmctl.cli.options import RESULT, command
from edmctl.cli.outcome import Outcome

RealOption = Annotated[
    str | None,
    typer.Option("--real", metavar="double|float", help="Arithmetic of the library. Default: both."),
]


@command("firmware build", RESULT)
def build(outcome: Outcome, real: RealOption = None) -> None:
    """Build the firmware's core as a library for virtual machines, unless that was done before.

    It takes a C compiler: CC names one, else one of the system is taken, else that of the package ziglang. The
    library is kept in the user's cache folder, or in EDMCTL_FIRMWARE_CACHE. Jobs with --controller firmware build by
    themselves what they need.
    """
    from dataclasses import asdict

    from edmctl.errors import UsageError
    from edmctl.firmware.build import REALS, built

    if real is not None and real not in REALS:
        raise UsageError(f"--real {real} is no arithmetic.", hint=f"Say {' or '.join(REALS)}.", code="E2048")
    builds = [built(kind) for kind in REALS if real in (None, kind)]
    outcome.result = {"builds": [{**asdict(made), "path": str(made.path)} for made in builds]}
    lines = [
        f"{made.real}: {made.path}, {'built now' if made.is_new else 'built before'} by {made.compiler}"
        for made in builds
    ]
    outcome.text = "\n".join(lines)
