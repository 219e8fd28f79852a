"""Seeds of the simulator."""

from __future__ import annotations

import secrets

from edmctl.errors import UsageError

# Nine digits at most: short enough to read out and type again.
_NEW_SEEDS = 1_000_000_000
# The run file keeps the seed in 64 bits with a sign.
_LARGEST = 2**63 - 1


def simulated_by(seed: int | None) -> str:
    """Return the remark on a simulated result; a served controller's seed is not known here."""
    return "Simulated. " if seed is None else f"Simulated, seed {seed}. "


def seed_to_use(asked: int | None, runs: int = 1) -> int:
    """Return the first seed that was asked for, else a new one, to be printed and recorded.

    Raises UsageError (E2005) when the run file cannot hold it, or the last of the seeds of `runs` runs.
    """
    if asked is None:
        return secrets.randbelow(_NEW_SEEDS)
    largest = _LARGEST - (runs - 1)
    if not 0 <= asked <= largest:
        of_runs = f" (of the first of {runs} runs)" if runs > 1 else ""
        raise UsageError(
            f"Seed {asked} does not lie between 0 and {largest}{of_runs}.",
            hint="Leave --seed out for a random one.",
            code="E2005",
        )
    return asked
