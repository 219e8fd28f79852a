"""Circles among the files of the package: `python tools/import_circles.py`.

Every import counts, those for types alone and those within functions as well. Prints each circle and ends with 1
where there is one.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

PACKAGE = "edmctl"
ROOT = Path(__file__).parents[1]


def imports_of(path: Path, names: set[str]) -> set[str]:
    """Modules of `names` that a file imports anywhere."""
    package = module_of(path) if path.name == "__init__.py" else module_of(path).rpartition(".")[0]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names if alias.name in names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")
                base = ".".join([*parts[: len(parts) - node.level + 1], *([base] if base else [])])
            below = {f"{base}.{alias.name}" for alias in node.names} & names
            found |= below
            if base in names and len(below) < len(node.names):
                found.add(base)
    return found - {module_of(path)}


def module_of(path: Path) -> str:
    """Dotted name of a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules of which each reaches every other (Tarjan 1972), the largest first."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            group: list[str] = []
            while not group or group[-1] != name:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for name in sorted(graph):
        if name not in index:
            visit(name)
    return sorted(found, key=len, reverse=True)


def main() -> int:
    """Print the circles; the exit code."""
    files = {module_of(path): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}
    graph = {name: imports_of(path, set(files)) for name, path in files.items()}
    found = circles(graph)
    for group in found:
        print(f"{len(group)} files import each other in a circle:")
        for name in group:
            print(f"  {name} <- {', '.join(sorted(graph[name] & set(group)))}")
    print(f"{len(files)} files, {len(found)} circles")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
