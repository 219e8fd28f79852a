"""Golden digests of plant and controller: every byte on the line in fixed sessions and schedules, and the plant.

    python -m tests.simulator.golden_core --record "why they change"

writes golden_core.json anew: digests of the sessions of benchmarks/kernel.py, of random schedules and of wide random
schedules (tests/firmware/schedules.py), and the reason. Earlier records are kept below them, the last one first.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks import kernel
from tests.firmware.schedules import Schedule, WideSchedule

GOLDEN = Path(__file__).with_name("golden_core.json")
SCHEDULES = range(1, 151)
WIDE = range(1, 51)
STEPS = 150
DIGITS = 16
"""Hexadecimal digits kept of a digest."""


def golden() -> dict[str, dict[str, str]]:
    """Return the recorded digests: "sessions", "schedules" and "wide" by the name or seed of each."""
    recorded: dict[str, dict[str, str]] = json.loads(GOLDEN.read_text(encoding="utf-8"))["digests"]
    return recorded


def session(name: str) -> str:
    """Return the digest of a session now."""
    return kernel.digests([name])[name][:DIGITS]


def schedule(kind: type[Schedule], seed: int) -> str:
    """Return the digest of a random schedule now."""
    random_host = kind(seed)
    random_host.run(STEPS)
    return random_host.digest()[:DIGITS]


def main() -> int:
    """Record the digests."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--record", metavar="REASON", required=True)
    reason = parser.parse_args().record
    digests = {
        "sessions": {name: session(name) for name in kernel.sessions()},
        "schedules": {str(seed): schedule(Schedule, seed) for seed in SCHEDULES},
        "wide": {str(seed): schedule(WideSchedule, seed) for seed in WIDE},
    }
    before = json.loads(GOLDEN.read_text(encoding="utf-8"))
    earlier = [before, *before.pop("earlier", [])]
    text = json.dumps({"reason": reason, "digests": digests, "earlier": earlier}, indent=1)
    GOLDEN.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
