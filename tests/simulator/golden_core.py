"""Golden digests of plant, controller and operators: every byte on the line in sessions and schedules, the plant.

    python -m tests.simulator.golden_core --record "why they change"
    python -m tests.simulator.golden_core --check [--build FOLDER [--flags=-O1] | --library FILE]

`--record` writes golden_core.json anew: digests of the sessions of benchmarks/kernel.py, of random schedules and of
wide random schedules (tests/firmware/schedules.py), of the actuator model's operators on random banks
(tests/actuator/operator_banks.py), and the reason. Earlier records are kept below, the last first.
`--check` prints how many digests are the recorded ones now; the exit code is 1 if any is not. With `--build` the
library is compiled into a folder, by the compiler that CC names and with more flags behind the project's.
`--library` is one that was compiled before with the project's flags.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from pathlib import Path

from benchmarks import kernel
from edmctl.core import build
from tests.actuator import operator_banks
from tests.firmware.schedules import Schedule, WideSchedule

GOLDEN = Path(__file__).with_name("golden_core.json")
SCHEDULES = range(1, 151)
WIDE = range(1, 51)
BANKS = range(20)
STEPS = 150
SAMPLE = (
    "seed 1",
    "50 kHz",
    "200 Hz",
    "PI servo",
    "slow servo",
    "no sensor",
    "ESTOP",
    "WATCHDOG",
    "CARBON",
    "WIRE_SHORT",
    "SILENCE",
    "LINE_NOISE",
)
"""Sessions of the default tier."""
SAMPLE_SEEDS = 9, 3
"""Schedules and wide ones of the default tier."""
DIGITS = 16
"""Hexadecimal digits kept of a digest."""


def golden() -> dict[str, dict[str, str]]:
    """Return the recorded digests: by group, then by the name or seed of each."""
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


def operators(seed: int) -> str:
    """Return the digest of the operators on a bank now."""
    return operator_banks.digest_of(seed)[:DIGITS]


def digests_now() -> dict[str, dict[str, str]]:
    """Return the digests now."""
    return {
        "sessions": {name: session(name) for name in kernel.sessions()},
        "schedules": {str(seed): schedule(Schedule, seed) for seed in SCHEDULES},
        "wide": {str(seed): schedule(WideSchedule, seed) for seed in WIDE},
        "operators": {str(seed): operators(seed) for seed in BANKS},
    }


def use_library_built_with(flags: str, folder: Path) -> None:
    """Compile the library with more flags, and use it in this process, which has loaded none yet."""
    build._FLAGS = (*build._FLAGS, *shlex.split(flags))
    made = folder / f"core{build.SUFFIX}"
    build.compile_library(build.compiler(os.environ.get("CC", "")), made)
    use_library(made)


def use_library(file: Path) -> None:
    """Use a library in this process, which has loaded none yet."""
    if not build.is_whole(file):
        raise ValueError(f"{file} is not a library with its hash beside it")
    build.packaged = lambda *_: file


def check() -> int:
    """Print how many digests are the recorded ones; return the exit code."""
    recorded, differing = golden(), 0
    for group, now in digests_now().items():
        others = [name for name, digest in now.items() if digest != recorded[group][name]]
        print(f"{len(now) - len(others)} of {len(now)} {group} as recorded", *others)
        differing += len(others)
    return int(differing > 0)


def record(reason: str) -> None:
    """Record the digests."""
    before = json.loads(GOLDEN.read_text(encoding="utf-8"))
    earlier = [before, *before.pop("earlier", [])]
    text = json.dumps({"reason": reason, "digests": digests_now(), "earlier": earlier}, indent=1)
    GOLDEN.write_text(text + "\n", encoding="utf-8")


def main() -> int:
    """Record or check; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    act = parser.add_mutually_exclusive_group(required=True)
    act.add_argument("--record", metavar="REASON")
    act.add_argument("--check", action="store_true")
    parser.add_argument("--build", type=Path, metavar="FOLDER")
    parser.add_argument("--flags", default="")
    parser.add_argument("--library", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if arguments.library:
        use_library(arguments.library)
    if arguments.build:
        use_library_built_with(arguments.flags, arguments.build)
    if arguments.check:
        return check()
    record(arguments.record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
