"""Hands at a served virtual machine: a file to which others append what is to happen, a line each.

`+NAME` or `+NAME@WHEN` is an injection, `-NAME` mends it. Lines that were there before are no acts.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edmctl.files import open_regular
from edmctl.simulator.bench import VirtualBench
from edmctl.simulator.injection import parse_injection


class ActsFile:
    """Does on a bench what is appended to a file; `say` hears of it. The file is made where there is none.

    Raises OSError.
    """

    def __init__(self, path: Path, bench: VirtualBench, say: Callable[[str], None]) -> None:
        path.touch()
        self._path, self._bench, self._say = path, bench, say
        self._at = path.stat().st_size

    def __call__(self) -> None:
        """Look at the file, and do what is new in it, whole lines alone."""
        if self._path.stat().st_size <= self._at:
            return
        with open_regular(self._path) as acts:
            acts.seek(self._at)
            new = acts.read()
        whole = new[: new.rfind(b"\n") + 1]
        self._at += len(whole)
        for line in whole.decode("ascii", errors="replace").split():
            self._do(line)

    def _do(self, line: str) -> None:
        name = line[1:]
        try:
            if line[0] == "-":
                self._bench.controller.injector.mend(name)
            elif line[0] == "+":
                self._bench.inject(parse_injection(name if "@" in name else f"{name}@0"))
            else:
                raise ValueError(f"{line!r} begins with neither + nor -")
        except ValueError as wrong:
            self._say(f"acts: {wrong}")
