"""`edmctl doctor`: everything that a job will need, looked at one by one."""

import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import NOTES, PortOption, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, stream_style, tell
from edmctl.cli.signals import shell
from edmctl.errors import EdmError, Interrupted, LinkLost, ProtocolMismatch

if TYPE_CHECKING:
    from edmctl.jobs.doctor_host import Checks

OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the run files.")]
SensorsOption = Annotated[
    bool,
    typer.Option(
        "--sensors", help="Also arm, make pulses with the tool retracted to test the gap sensor, and disarm."
    ),
]


@command("doctor", NOTES)
def doctor(
    outcome: Outcome,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    sensors: SensorsOption = False,
    out: OutOption = Path("runs"),
) -> None:
    """Check computer, line and machine, and name the remedies.

    Nothing moves, but with --sensors.
    """
    from edmctl.console.procedure_tables import render_checks
    from edmctl.jobs.doctor_host import Checks

    checks = Checks()
    error = None
    try:
        error = _look(outcome, checks, setup, (port, wait), out, sensors=sensors)
    finally:
        outcome.result = {"checks": checks.as_list()}
        outcome.text = render_checks(checks.done, stream_style(sys.stdout))
    if error or (error := checks.error()):
        raise error


def _look(
    outcome: Outcome,
    checks: "Checks",
    setup_file: Path | None,
    place: tuple[str | None, float],
    out: Path,
    *,
    sensors: bool,
) -> "EdmError | None":
    """Do every check that can be done; the error of the line or the protocol, if that is what fails."""
    from edmctl.jobs import doctor_host as doctor_host
    from edmctl.jobs import doctor_machine as doctor_machine
    from edmctl.jobs.connect import machine_at

    say = partial(tell, outcome.output)
    port, wait_s = place
    checks.add(doctor_host.versions())
    checks.add(doctor_host.run_folder(out))
    setup = doctor_host.load(checks, setup_file)
    selector = port or setup.port
    checks.add(*doctor_host.line_settings(selector))
    try:
        with machine_at(setup, port, wait_s, say, shell()) as bench:
            machine = bench.machine
            if bench.own_setup is not None:
                setup = bench.own_setup
            outcome.simulated = machine.identity.simulated
            doctor_machine.look(checks, machine, setup)
            checks.add(doctor_host.calibration(os.environ, setup, machine.identity.serial, port or ""))
            if sensors:
                say("doctor: arming, and making pulses with the tool retracted, for about a second.")
                doctor_machine.test_sensors(checks, machine, setup)
    except ProtocolMismatch as error:
        checks.fail("protocol", error)
        return error
    except Interrupted:
        raise
    except EdmError as error:
        checks.fail("port", error)
        return error if isinstance(error, LinkLost) else None
    finally:
        if all(check.name != "setup" for check in checks.done):
            checks.add(doctor_host.setup_used(setup))
    return None
