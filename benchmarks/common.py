"""What benchmarks share: their options, and jobs on virtual machines."""

from __future__ import annotations

import argparse
from random import Random
from typing import TYPE_CHECKING, Any

from edmctl.errors import EdmError
from edmctl.jobs.surroundings import Unobserved
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.stop import StopRequest
from edmctl.procedures.job import JobTally
from edmctl.procedures.machining import run_job
from edmctl.record.rows import NullRecorder

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from edmctl.link.transport import Transport
    from edmctl.procedures.job import Job, StateStore
    from edmctl.record.rows import Recorder
    from edmctl.results.progress import Observer


def options(
    doc: str | None, choices: Mapping[str, Collection[str]] | None = None, **defaults: Any
) -> argparse.Namespace:
    """Read `--name VALUE` for every default, of its type; a list takes several values, False is a flag.

    choices : permitted values by name
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        option, of = f"--{name.replace('_', '-')}", (choices or {}).get(name)
        if default is False:
            parser.add_argument(option, action="store_true")
        elif isinstance(default, list | tuple):
            kind = type(default[0]) if default else str
            parser.add_argument(option, nargs="+", type=kind, default=default, choices=of)
        else:
            kind = str if default is None else type(default)
            parser.add_argument(option, type=kind, default=default, choices=of)
    return parser.parse_args()


def machine_on(line: Transport, seed: int = 1, stop: StopRequest | None = None) -> LinkMachine:
    """Open a session on a line, and return its machine."""
    session = Session(line, Random(seed))
    session.open()
    return LinkMachine(session, stop or StopRequest())


def machined(
    machine: LinkMachine,
    job: Job,
    store: StateStore,
    recorder: Recorder | None = None,
    observer: Observer | None = None,
) -> tuple[JobTally, EdmError | None]:
    """Run a job; return its results, and the error that ended it."""
    tally = JobTally()
    try:
        run_job(
            machine,
            job,
            recorder=recorder or NullRecorder(),
            observer=observer or Unobserved(),
            tally=tally,
            store=store,
        )
    except EdmError as error:
        return tally, error
    return tally, None
