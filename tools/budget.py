"""Size of the code: `python -m tools.budget [--lower]`, from the project's folder.

Counted are the lines of each group of folders, files, functions of more than 60 lines, and functions of more than
nine parameters. Hand-written .py, .toml, .css and .html files count; generated ones say so in their first lines.
Parameters of commands, which are options, and keywords of the public API do not count.
Everything has a budget and a limit. The exit code is 1 if something exceeds its limit. What is above its budget has
its present size as limit; --lower sets the limits to the present sizes. Raising a number needs a decision record.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("budget.toml")
OTHERS = ("sum", "files", "functions over 60 lines", "functions over 9 parameters", "tests", "benchmarks")
"""Names in the table that are not groups of folders."""
MOST_LINES, MOST_PARAMETERS = 60, 9
MADE = re.compile("Made from .* by `python -m tools.generate`")
SUFFIXES = (".py", ".toml", ".css", ".html")


def sizes(folder: Path) -> dict[Path, int]:
    """Return the lines of each hand-written file of a folder."""
    found = {}
    for path in folder.rglob("*"):
        if path.suffix in SUFFIXES:
            lines = path.read_text(encoding="utf-8").splitlines()
            if not MADE.search("".join(lines[:5])):
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
    for path in in_package:
        if path.suffix == ".py":
            size += function_sizes(path)
    for name in ("tests", "benchmarks"):
        size[name] = sum(sizes(ROOT / name).values())
    return size


def function_sizes(path: Path) -> Counter[str]:
    """Return how many functions of a file are long, and how many have many parameters."""
    found: Counter[str] = Counter()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            is_command = any(
                isinstance(one, ast.Call) and ast.unparse(one.func) == "command"
                for one in node.decorator_list
            )
            own = [one for one in (*node.args.posonlyargs, *node.args.args) if one.arg not in ("self", "cls")]
            keywords = [] if path.name == "api.py" else node.args.kwonlyargs
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            found["functions over 60 lines"] += lines > MOST_LINES
            found["functions over 9 parameters"] += (
                not is_command and len(own) + len(keywords) > MOST_PARAMETERS
            )
    return found


def main(arguments: list[str]) -> int:
    """Compare and print; return the exit code."""
    text = TABLE.read_text(encoding="utf-8")
    groups = tomllib.loads(text)["lines"]
    size = measured(groups)
    lowered = {name: min(group["limit"], max(size[name], group["budget"])) for name, group in groups.items()}
    lowered["sum"] = sum(lowered[name] for name in groups if name not in OTHERS)
    exceeded = False
    for name, group in groups.items():
        budget, limit = group["budget"], group["limit"]
        note = "  above its budget" if size[name] > budget else ""
        if size[name] > limit:
            exceeded, note = True, f"  exceeds its limit of {limit}"
        sys.stdout.write(f"{name:28} {size[name]:6} of {budget:6}{note}\n")
        if arguments == ["--lower"]:
            entry = re.compile(rf'(?m)^("{re.escape(name)}" = \{{ budget = \d+, limit = )\d+')
            text = entry.sub(rf"\g<1>{lowered[name]}", text)
    if arguments == ["--lower"]:
        TABLE.write_text(text, encoding="utf-8")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
