"""Kill rate of random mutants: how many seeded changes of the code the default tier's tests detect.

    python -m benchmarks.random_mutants [--seed 1] [--count 300] [--jobs 2] [--show]

A copy of the tree is changed in one place at a time: a comparison, an operator, a condition or a number in
`procedures/`, `process/`, `actuator/` or `link/`. Only places that the default tier executes are chosen; which tests
execute them is measured once with coverage.py and kept beside the copies. At most TESTS of these tests run for each
mutant, the most specific first. Printed is the share of mutants that fail a test, with its 95 % interval, by folder.
To compare two commits, run the tool of one of them in both trees: `--root OTHER`.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from random import Random

from statsmodels.stats.proportion import proportion_confint

ROOT = Path(__file__).parents[1]
FOLDERS = ("procedures", "process", "actuator", "link")
TESTS = 12
TIMEOUT_S = 120.0
COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
CALCULATED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}


def places(tree: ast.Module) -> Iterator[ast.expr | ast.If]:
    """Yield what can be changed, in the order of the source: never annotations, decorators or docstrings."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                if (
                    (isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED)
                    or (isinstance(node, ast.BinOp) and type(node.op) in CALCULATED)
                    or isinstance(node, ast.BoolOp | ast.If)
                    or (isinstance(node, ast.Constant) and type(node.value) in (int, float))
                ):
                    yield node


def change(node: ast.expr | ast.If) -> str:
    """Change a node in place; return what was done."""
    before = ast.unparse(node.test if isinstance(node, ast.If) else node)
    if isinstance(node, ast.Compare):
        node.ops[0] = COMPARED[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp):
        node.op = CALCULATED[type(node.op)]()
    elif isinstance(node, ast.BoolOp):
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    elif isinstance(node, ast.If):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        node.value += 1
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        node.value = 1.5 * node.value + 0.1
    after = ast.unparse(node.test if isinstance(node, ast.If) else node)
    return f"{before} -> {after}"


def copy_of(root: Path, folder: Path) -> Path:
    """Copy the tracked files of a tree."""
    names = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    for name in filter(None, names):
        if (root / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, folder / name)
    return folder


def run(tree: Path, *arguments: str, timeout_s: float | None = None) -> int:
    """Run Python in a tree; return its exit code, -1 where it took too long."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=tree,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return -1
    return done.returncode


def covering(tree: Path, files: Sequence[Path], jobs: int) -> dict[tuple[str, int], list[str]]:
    """Return the tests that execute each line, by file and line, the most specific tests first."""
    settings = tree / ".mutants-coverage"
    settings.write_text(
        "[run]\nsource = edmctl\nparallel = true\ndynamic_context = test_function\n", encoding="utf-8"
    )
    command = ("-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest", "-q")
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(lambda part: run(tree, *command, *map(str, files[part::jobs])), range(jobs)))
    run(tree, "-m", "coverage", "combine", f"--rcfile={settings}")
    tests: dict[tuple[str, int], list[str]] = defaultdict(list)
    sizes: dict[str, int] = defaultdict(int)
    with sqlite3.connect(tree / ".coverage") as data:
        rows = data.execute(
            "SELECT file.path, context.context, line_bits.numbits FROM line_bits "
            "JOIN file ON file.id = line_bits.file_id JOIN context ON context.id = line_bits.context_id"
        ).fetchall()
    for path, context, bits in rows:
        if context:
            name = str(Path(path).relative_to(tree))
            for line in (8 * at + bit for at, byte in enumerate(bits) for bit in range(8) if byte >> bit & 1):
                tests[name, line].append(context)
                sizes[context] += 1
    return {place: sorted(found, key=sizes.__getitem__) for place, found in tests.items()}


def chosen(
    tree: Path, tests: dict[tuple[str, int], list[str]], seed: int, count: int
) -> list[tuple[str, int]]:
    """Return the file and the number of the place of each mutant."""
    all_places = [
        (str(path.relative_to(tree)), number)
        for folder in FOLDERS
        for path in sorted((tree / "edmctl" / folder).rglob("*.py"))
        for number, node in enumerate(places(ast.parse(path.read_text(encoding="utf-8"))))
        if tests.get((str(path.relative_to(tree)), node.lineno))
    ]
    return Random(seed).sample(all_places, min(count, len(all_places)))


def is_killed(
    tree: Path, name: str, number: int, tests: dict[tuple[str, int], list[str]]
) -> tuple[bool, str]:
    """Change one place, run its tests, restore; return whether one failed, and what was changed."""
    file = tree / name
    source = file.read_text(encoding="utf-8")
    module = ast.parse(source)
    node = list(places(module))[number]
    done = f"{name}:{node.lineno}: {change(node)}"
    file.write_text(ast.unparse(ast.fix_missing_locations(module)), encoding="utf-8")
    try:
        for context in tests[name, node.lineno][:TESTS]:
            module_name, _, function = context.rpartition(".")
            test = f"{module_name.replace('.', '/')}.py::{function}"
            if run(tree, "-m", "pytest", "-q", "-x", test, timeout_s=TIMEOUT_S) not in (0, 5):
                return True, done
        return False, done
    finally:
        file.write_text(source, encoding="utf-8")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--root", type=Path, default=ROOT)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--tests", nargs="+", default=["tests"], help="folders of the tests (default: all)")
    parser.add_argument("--show", action="store_true", help="print the mutants that survive")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="edmctl-mutants-") as folder:
        trees = [copy_of(options.root.resolve(), Path(folder, str(n))) for n in range(options.jobs)]
        files = [file for part in options.tests for file in sorted((trees[0] / part).rglob("test_*.py"))]
        tests = covering(trees[0], files, options.jobs)
        free: SimpleQueue[Path] = SimpleQueue()
        for tree in trees:
            free.put(tree)

        def tried(place: tuple[str, int]) -> tuple[str, bool, str]:
            tree = free.get()
            try:
                return place[0].split("/")[1], *is_killed(tree, *place, tests)
            finally:
                free.put(tree)

        with ThreadPoolExecutor(options.jobs) as pool:
            outcomes = list(pool.map(tried, chosen(trees[0], tests, options.seed, options.count)))
    for name in (*FOLDERS, "all"):
        killed = [was_killed for folder, was_killed, _ in outcomes if name in (folder, "all")]
        low, high = proportion_confint(sum(killed), max(len(killed), 1), method="wilson")
        print(
            f"{name:12} {sum(killed):4} of {len(killed):4} mutants killed, "
            f"{sum(killed) / max(len(killed), 1):.3f} ({low:.3f} to {high:.3f})"
        )
    if options.show:
        print(*(done for _, was_killed, done in outcomes if not was_killed), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
