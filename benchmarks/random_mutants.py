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
import sqlite3
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random

from statsmodels.stats.proportion import proportion_confint

from benchmarks.mutation_check import Copies, changed, failing_test

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


def covering(tree: Path, files: Sequence[Path], jobs: int) -> dict[tuple[str, int], list[str]]:
    """Return the tests that execute each line, by file and line, the most specific tests first."""
    settings = tree / ".mutants-coverage"
    settings.write_text(
        "[run]\nsource = edmctl\nparallel = true\ndynamic_context = test_function\n", encoding="utf-8"
    )
    coverage = [sys.executable, "-m", "coverage"]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    parts = [
        subprocess.Popen(
            [*coverage, "run", f"--rcfile={settings}", "-m", "pytest", "-q", *map(str, files[part::jobs])],
            cwd=tree,
            env=environment,
        )
        for part in range(jobs)
    ]
    if failed := [part.returncode for part in parts if part.wait()]:
        raise RuntimeError(f"The tests fail without a mutant: pytest ended with {failed}.")
    subprocess.run([*coverage, "combine", f"--rcfile={settings}"], cwd=tree, check=True)
    tests: dict[tuple[str, int], list[str]] = defaultdict(list)
    sizes: dict[str, int] = defaultdict(int)
    with sqlite3.connect(tree / ".coverage") as data:
        rows = data.execute(
            "SELECT file.path, context.context, line_bits.numbits FROM line_bits "
            "JOIN file ON file.id = line_bits.file_id JOIN context ON context.id = line_bits.context_id"
        ).fetchall()
    for path, context, bits in rows:
        if context.startswith("tests."):  # a library may name functions like tests
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
    """Change one place and run its tests; return whether one failed, and what was changed."""
    file = tree / name
    module = ast.parse(file.read_text(encoding="utf-8"))
    node = list(places(module))[number]
    done = f"{name}:{node.lineno}: {change(node)}"
    covering_tests = [test_id(context) for context in tests[name, node.lineno][:TESTS]]
    with changed(file, ast.unparse(ast.fix_missing_locations(module)).encode()):
        return bool(failing_test(tree, covering_tests, TIMEOUT_S)), done


def test_id(context: str) -> str:
    """Return the name under which pytest knows the function of a context of coverage.py."""
    module, _, function = context.rpartition(".")
    return f"{module.replace('.', '/')}.py::{function}"


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
        copies = Copies(options.root.resolve(), Path(folder), options.jobs)
        with copies.one() as tree:
            files = [file for part in options.tests for file in sorted((tree / part).rglob("test_*.py"))]
            tests = covering(tree, files, options.jobs)
            mutants = chosen(tree, tests, options.seed, options.count)

        def tried(mutant: tuple[str, int]) -> tuple[str, bool, str]:
            with copies.one() as tree:
                return mutant[0].split("/")[1], *is_killed(tree, *mutant, tests)

        with ThreadPoolExecutor(options.jobs) as pool:
            outcomes = list(pool.map(tried, mutants))
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
