"""A machine to ask something of, without a job."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from edmctl.jobs.connect import connected
from edmctl.jobs.plan import where_is
from edmctl.jobs.simulate.seeds import seed_to_use

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.jobs.surroundings import Surroundings
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup

SEED = 1
"""Of a fresh virtual machine, which a question does not depend on. One that will be kept is any machine."""


@contextmanager
def machine_at(
    setup: Setup,
    port: str | None,
    wait_s: float,
    say: Callable[[str], None],
    surroundings: Surroundings,
) -> Iterator[LinkMachine]:
    """Connect to the machine that the option or the setup names.

    Raises LinkLost and ProtocolMismatch.
    """
    where = where_is(port, setup, wait_s)
    seed = SEED if where.bench_file is None else seed_to_use(None)
    with connected(None, setup, seed, say, where, surroundings) as bench:
        bench.begin()
        yield bench.machine
