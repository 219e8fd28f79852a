"""A machine to ask something of, without a job."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from edmctl.cli.bench import connected, where_is

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup

SEED = 1
"""Of the virtual machine, which a question does not depend on."""


@contextmanager
def machine_at(
    setup: Setup, port: str | None, wait_s: float, say: Callable[[str], None]
) -> Iterator[LinkMachine]:
    """Connect to the machine that the option, the environment or the setup names.

    Raises LinkLost and ProtocolMismatch.
    """
    with connected(None, setup, SEED, say, where_is(port, setup, wait_s)) as bench:
        yield bench.machine
