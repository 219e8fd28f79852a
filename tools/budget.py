"""Line budgets of the folders: `python -m tools.budget [--lower]`, from the project's folder.

Hand-written .py, .toml, .css and .html files count; generated ones name `tools.generate` in their first lines.
Each group of folders has a budget and a limit. The exit code is 1 if a group exceeds its limit. A group above its
budget has its present size as limit; --lower sets the limits to the present sizes. Raising a number needs a decision
record.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("budget.toml")
SUFFIXES = (".py", ".toml", ".css", ".html")


def files(folder: Path) -> Iterator[Path]:
    """Yield the hand-written files of a folder."""
    for path in sorted(folder.rglob("*")):
        if path.suffix in SUFFIXES and "__pycache__" not in path.parts and "source" not in path.parts:
            with path.open(encoding="utf-8") as text:
                if "tools.generate" not in "".join(next(text, "") for _ in range(5)):
                    yield path


def lines(folder: Path) -> int:
    """Return the lines of the hand-written files of a folder."""
    return sum(path.read_text(encoding="utf-8").count("\n") for path in files(folder))


def measured(groups: dict[str, dict[str, int]]) -> dict[str, int]:
    """Return the size of each group in lines, of the group `files` in files.

    The group `rest` is everything in edmctl/ that no other group contains.
    """
    package = ROOT / "edmctl"
    found = {
        name: sum(lines(package / part) for part in name.split("+"))
        for name in groups
        if all((package / part).is_dir() for part in name.split("+"))
    }
    return found | {
        "rest": lines(package) - sum(found.values()),
        "sum": lines(package),
        "files": sum(path.suffix == ".py" for path in files(package)),
        "tests": lines(ROOT / "tests"),
        "benchmarks": lines(ROOT / "benchmarks"),
    }


def main(arguments: list[str]) -> int:
    """Compare and print; return the exit code."""
    text = TABLE.read_text(encoding="utf-8")
    groups = tomllib.loads(text)["lines"]
    exceeded = False
    for name, size in measured(groups).items():
        budget, limit = groups[name]["budget"], groups[name]["limit"]
        exceeded |= size > limit
        note = (
            f"  exceeds its limit of {limit}"
            if size > limit
            else ""
            if size <= budget
            else "  above its budget"
        )
        sys.stdout.write(f"{name:18} {size:6} of {budget:6}{note}\n")
        if arguments == ["--lower"] and size < limit:
            entry = re.compile(rf'(?m)^("?{re.escape(name)}"? = \{{ budget = \d+, limit = )\d+')
            text = entry.sub(rf"\g<1>{max(size, budget)}", text)
    if arguments == ["--lower"]:
        TABLE.write_text(text, encoding="utf-8")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
