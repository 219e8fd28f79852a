"""CPU time of the tests, by file and tier: `python tools/durations.py [--write] [PYTEST ARGUMENTS]`.

Runs every tier, or what the arguments choose, and prints the table; `--write` writes it to `tests/durations.md`.
CPU time of a test includes its fixtures, where it is the first to ask for them, and the processes that it starts.
Unlike time on the wall it hardly depends on what else the machine does.
"""

from __future__ import annotations

import os
import platform
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "durations.md"
TIERS = ("default", "slow", "full")
DEAREST = 25
PLUGIN = "tools.durations"
"""This module by the name under which workers load it."""

_began_s = 0.0
_spent_s: dict[tuple[str, str], float] = {}


def cpu_s() -> float:
    """CPU time of this process and of the children it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def tier_of(item: pytest.Item) -> str:
    """The tier that a test is in: the rarest that a marker names."""
    return next((tier for tier in reversed(TIERS) if item.get_closest_marker(tier)), TIERS[0])


def pytest_runtest_logstart() -> None:
    """Begin to count."""
    global _began_s
    _began_s = cpu_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Send what was counted with the last report of a test."""
    report = yield
    if call.when == "teardown":
        report.user_properties.append((tier_of(item), cpu_s() - _began_s))
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep what arrives, from this process or from a worker."""
    for tier, spent in report.user_properties:
        if tier in TIERS:
            _spent_s[report.nodeid, tier] = float(str(spent))


def table(spent: dict[tuple[str, str], float]) -> str:
    """The table of the files, the most expensive first, and the most expensive tests of the default tier."""
    seconds: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    tests: dict[str, Counter[str]] = defaultdict(Counter)
    for (test, tier), time_s in spent.items():
        file = test.partition("::")[0]
        for row in (file, "all"):
            seconds[row][tier] += time_s
            tests[row][tier] += 1
    lines = [
        "# CPU time of the tests",
        "",
        "Made by `python tools/durations.py --write`, "
        f"Python {platform.python_version()} on {platform.machine()}. Seconds of CPU: divided by the number of",
        "cores they are about the time on the wall of an idle machine.",
        "",
        "| file | " + " | ".join(f"{tier}: tests | s" for tier in TIERS) + " |",
        "|---|" + "--:|--:|" * len(TIERS),
    ]
    for row in sorted(seconds, key=lambda name: (name != "all", -sum(seconds[name].values()), name)):
        cells = [f"{tests[row][t]} | {seconds[row][t]:.1f}" if tests[row][t] else " | " for t in TIERS]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    lines += ["", f"The {DEAREST} most expensive of the default tier:", "", "| test | s |", "|---|--:|"]
    default = {test: time_s for (test, tier), time_s in spent.items() if tier == TIERS[0]}
    for test in sorted(default, key=lambda name: (-default[name], name))[:DEAREST]:
        lines.append(f"| `{test.removeprefix('tests/')}` | {default[test]:.1f} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Run the tests and print or write the table; the exit code is that of pytest."""
    chosen = [word for word in arguments if word != "--write"]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    exit_code = pytest.main(["-p", PLUGIN, "-n", "auto", "--dist", "worksteal", "-m", "", *chosen])
    made = table(sys.modules[PLUGIN]._spent_s)
    if "--write" in arguments:
        TABLE.write_text(made, encoding="utf-8")
    else:
        print(made)
    return int(exit_code)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
