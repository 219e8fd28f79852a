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
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("budget.toml")
SUFFIXES = (".py", ".toml", ".css", ".html")


def sizes(folder: Path) -> dict[Path, int]:
    """Return the lines of each hand-written file of a folder."""
    found = {}
    for path in folder.rglob("*"):
        if path.suffix in SUFFIXES:
            lines = path.read_text(encoding="utf-8").splitlines()
            if "tools.generate" not in "".join(lines[:5]):
                found[path] = len(lines)
    return found


def measured(groups: Iterable[str]) -> dict[str, int]:
    """Return the size of each group in lines, of the group `files` in files.

    The group `rest` is everything in edmctl/ that no other group contains.
    """
    package = ROOT / "edmctl"
    in_package = sizes(package)
    group_of = {part: group for group in groups for part in group.split("+")}
    size: Counter[str] = Counter()
    for path, lines in in_package.items():
        folder = path.relative_to(package).parts[0]
        size[group_of.get(folder, "rest")] += lines
    size["sum"] = size.total()
    size["files"] = sum(path.suffix == ".py" for path in in_package)
    for name in ("tests", "benchmarks"):
        size[name] = sum(sizes(ROOT / name).values())
    return size


def main(arguments: list[str]) -> int:
    """Compare and print; return the exit code."""
    text = TABLE.read_text(encoding="utf-8")
    groups = tomllib.loads(text)["lines"]
    size = measured(groups)
    exceeded = False
    for name, group in groups.items():
        budget, limit = group["budget"], group["limit"]
        note = ""
        if size[name] > limit:
            exceeded, note = True, f"  exceeds its limit of {limit}"
        elif size[name] > budget:
            note = "  above its budget"
        sys.stdout.write(f"{name:18} {size[name]:6} of {budget:6}{note}\n")
        if arguments == ["--lower"] and size[name] < limit:
            entry = re.compile(rf'(?m)^("{re.escape(name)}" = \{{ budget = \d+, limit = )\d+')
            text = entry.sub(rf"\g<1>{max(size[name], budget)}", text)
    if arguments == ["--lower"]:
        TABLE.write_text(text, encoding="utf-8")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
