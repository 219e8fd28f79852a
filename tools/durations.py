"""CPU time of the tests, by file and tier: `python tools/durations.py [--write] [PYTEST ARGUMENTS]`.

Runs every tier, or what the arguments choose, and prints the table and the most expensive tests; `--write` puts what
was measured into `tests/durations.md`.
CPU time of a test includes its fixtures, where it is the first to ask for them, and the processes that it starts.
Unlike time on the wall it hardly depends on what else the machine does.
"""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "durations.md"
TIERS = ("default", "slow", "full")
DEAREST = 40
PLUGIN = "tools.durations"
"""This module by the name under which workers load it."""

Cell = tuple[int, float]
"""Number of tests, and their seconds."""

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


def rows_of(spent: dict[tuple[str, str], float]) -> dict[tuple[str, str], Cell]:
    """Number of tests and seconds by file and tier."""
    rows: dict[tuple[str, str], Cell] = {}
    for (test, tier), time_s in spent.items():
        key = (test.partition("::")[0], tier)
        number, sum_s = rows.get(key, (0, 0.0))
        rows[key] = (number + 1, sum_s + time_s)
    return rows


def rows_written(text: str) -> dict[tuple[str, str], Cell]:
    """The same of a table that was made before."""
    rows: dict[tuple[str, str], Cell] = {}
    for line in text.splitlines():
        file, *cells = (word.strip() for word in line.strip("| ").split("|"))
        if file.endswith(".py") and len(cells) == 2 * len(TIERS):
            for i, tier in enumerate(TIERS):
                if cells[2 * i] != "-":
                    rows[file, tier] = (int(cells[2 * i]), float(cells[2 * i + 1]))
    return rows


def table(rows: dict[tuple[str, str], Cell]) -> str:
    """The table of the files, the most expensive first."""

    def sums(files: set[str], tier: str) -> Cell:
        cells = [cell for (file, its), cell in rows.items() if its == tier and file in files]
        return sum(number for number, _ in cells), sum(time_s for _, time_s in cells)

    def line(name: str, files: set[str]) -> str:
        cells = [sums(files, tier) for tier in TIERS]
        return f"| {name} | " + " | ".join(f"{n} | {s:.1f}" if n else "- | -" for n, s in cells) + " |"

    files = {file for file, _ in rows}
    ordered = sorted(files, key=lambda file: (-sum(sums({file}, tier)[1] for tier in TIERS), file))
    lines = [
        "# CPU time of the tests",
        "",
        "Made by `python tools/durations.py --write`, "
        f"Python {platform.python_version()} on {platform.machine()}. Seconds of CPU: divided by the number of",
        "cores they are about the time on the wall of an idle machine; a busy one makes them more.",
        "",
        "| file | " + " | ".join(f"{tier}: tests | s" for tier in TIERS) + " |",
        "|---|" + "--:|--:|" * len(TIERS),
        line("all", files),
        *(line(file, {file}) for file in ordered),
    ]
    return "\n".join(lines) + "\n"


def dearest(spent: dict[tuple[str, str], float]) -> str:
    """The most expensive tests, a line each."""
    first = sorted(spent.items(), key=lambda item: -item[1])[:DEAREST]
    return "\n".join(f"{time_s:6.1f} s  {tier:8}{test}" for (test, tier), time_s in first)


def main(arguments: list[str]) -> int:
    """Run the tests and print or write the table; the exit code is that of pytest."""
    chosen = [word for word in arguments if word != "--write"]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    exit_code = pytest.main(["-p", PLUGIN, "-n", "auto", "--dist", "worksteal", "-m", "", *chosen])
    spent: dict[tuple[str, str], float] = sys.modules[PLUGIN]._spent_s
    rows = rows_of(spent)
    print(dearest(spent))
    if "--write" in arguments:
        kept = rows_written(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}
        rows = {key: cell for key, cell in (kept | rows).items() if (ROOT / key[0]).exists()}
        TABLE.write_text(table(rows), encoding="utf-8")
    else:
        print(table(rows))
    return int(exit_code)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
