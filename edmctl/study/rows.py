"""Rows of a study: what each run came to, what was told and judged later, and which runs were added."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import asdict, dataclass, field
from edmctl.jobs.plan import SIMULATOR, MachineAddress
from edmctl.record.json_rows import RowWriter, read_lines
from edmctl.study.design import is_within
from edmctl.study.responses import LARGEST
from edmctl.study.results import FactorInfo, Judgement, PlannedRun, RunKind, RunRow, StudyRun

if TYPE_CHECKING:
    Expected = Mapping[str, tuple[float, float, float]]
    """By response: what is expected of a run, and the bounds of its 95 % interval."""

RUN, TOLD, JUDGED, PLANNED, PAUSED, MACHINE = "run", "told", "judged", "planned", "paused", "machine"


class StudyWriter(RowWriter):
    """Appends the rows of a study."""

    def run(self, row: RunRow) -> None:
        """Append what a run came to."""
        self.append(RUN, asdict(row))

    def told(self, run: StudyRun, values: Mapping[str, float | None]) -> None:
        """Append what is told of a run, or of its first attempt where it is not made yet; None withdraws."""
        attempt = run.row.attempt if run.row is not None else 1
        self.append(TOLD, {"number": run.planned.number, "attempt": attempt, "values": dict(values)})

    def judged(self, run: StudyRun, judgement: Judgement, reason: str) -> None:
        """Append a judgement of a run's last attempt."""
        where = {"number": run.planned.number, "attempt": run.attempts}
        self.append(JUDGED, {**where, "judgement": str(judgement), "reason": reason})

    def planned(self, runs: Sequence[PlannedRun], expected: Expected | None = None) -> None:
        """Append runs that were not in the plan, suggestions or confirmations: all of them in one line, or none.

        `expected` is kept with confirmations: what is learnt later shall not change what they were to confirm.
        """
        kept: dict[str, object] = {}
        if expected is not None:
            kept["expected"] = {
                name: list(one) for name, one in expected.items() if all(map(math.isfinite, one))
            }
        self.append(PLANNED, {"runs": [asdict(run) for run in runs], **kept})


@dataclass(frozen=True, slots=True)
class Said:
    """What people have reported of an attempt: values, None if one is withdrawn, or a judgement."""

    attempt: int
    values: Mapping[str, float | None] = field(default_factory=dict)
    judgement: Judgement | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Rows:
    """All rows of a study: attempts by run, later knowledge, added runs and damaged lines (`torn`)."""

    attempts: Mapping[int, tuple[RunRow, ...]]
    said: Mapping[int, Sequence[Said]]
    """What was told and judged, by run, in the order of time."""
    added: tuple[PlannedRun, ...]
    expected: Mapping[int, Expected]
    """Of confirmations, by run."""
    paused: tuple[Mapping[str, Any], ...] = ()
    port: str = ""
    """Of the machine that lasts on which the runs are made, if they are made on one."""
    torn: int = 0

    def of(self, planned: PlannedRun) -> StudyRun:
        """Return a run with all that is known of it."""
        last = next(iter(self.attempts.get(planned.number, ())[::-1]), None)
        number = last.attempt if last else 0
        told: dict[str, float | None] = {}
        judgement, reason = None, ""
        for one in self.said.get(planned.number, ()):
            if one.judgement is None and one.attempt == max(1, number):
                told.update(one.values)
            elif one.judgement is not None and one.attempt == number:
                judgement, reason = one.judgement, one.reason
        known = {name: value for name, value in told.items() if value is not None}
        return StudyRun(planned, last, known, judgement, reason, number)


def read_rows(folder: Path) -> Rows:
    """Read the rows of a study. Raises RunFileError E9111 if a file cannot be read."""
    lines, torn = read_lines(folder)
    attempts: dict[int, dict[int, RunRow]] = {}
    said: dict[int, list[Said]] = {}
    added: dict[int, PlannedRun] = {}
    expected: dict[int, Expected] = {}
    paused: list[dict[str, Any]] = []
    port = ""
    for values in lines:
        kind = values.pop("row")
        try:
            if kind == RUN:
                row = _run_row(values)
                attempts.setdefault(row.number, {}).setdefault(row.attempt, row)
            elif kind in (TOLD, JUDGED):
                said.setdefault(int(values["number"]), []).append(_said(kind, values))
            elif kind == PLANNED:
                runs = [planned_run(one) for one in values["runs"]]
                own = _expected(values["expected"]) if "expected" in values else None
                for run in runs:
                    if added.setdefault(run.number, run) is run and own is not None:
                        expected[run.number] = own
            elif kind == PAUSED:
                need(_is_count(values["number"]) and isinstance(values["why"], str))
                paused.append(values)
            elif kind == MACHINE:
                port = _port_of(**values)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            torn += 1
    return Rows(
        {number: tuple(found[n] for n in sorted(found)) for number, found in attempts.items()},
        said,
        tuple(added[number] for number in sorted(added)),
        expected,
        tuple(paused),
        port,
        torn,
    )


def _said(kind: str, values: Mapping[str, Any]) -> Said:
    if kind == JUDGED:
        judgement = Judgement(values["judgement"])
        return Said(int(values["attempt"]), judgement=judgement, reason=str(values["reason"]))
    given = {str(name): value for name, value in values["values"].items()}
    need(all(value is None or _is_number(value) for value in given.values()))
    told = {name: None if value is None else float(value) for name, value in given.items()}
    return Said(max(1, int(values.get("attempt", 1))), told)


def bench_of(port: str) -> str:
    """Return the whole path of the file of a virtual bench; empty for every other machine."""
    file = MachineAddress(port).bench_file
    return "" if file is None else str(file.resolve())


def _port_of(port: str, bench: str = "") -> str:
    """Return the machine's port; a bench file by its whole path where its name leads to another one from here."""
    return port if not bench or bench_of(port) == bench else f"{SIMULATOR}{bench}"


def _run_row(values: dict[str, Any]) -> RunRow:
    site = values.pop("site_um")
    files = tuple(values.pop("run_files", ()))
    row = RunRow(**values, site_um=tuple(site) if site else None, run_files=files)
    for name in ("number", "point", "replicate", "block", "tool", "attempt", "order"):
        need(_is_count(getattr(row, name)))
    need(type(row.exit_code) is int and (row.seed is None or _is_count(row.seed)))
    for given in (row.responses, row.u, row.u95, row.truth):
        need(all(value is None or _is_number(value) for value in given.values()))
    texts = (row.kind, row.run_sha256, row.started, row.host, row.error or "", *files, *row.bases.values())
    need(all(isinstance(text, str) for text in texts) and isinstance(row.settings, dict))
    need(_is_number(row.duration_s) and (site is None or (len(site) == 2 and all(map(_is_number, site)))))
    return row


def _expected(values: Mapping[str, Any]) -> Expected:
    found: dict[str, tuple[float, float, float]] = {}
    for name, (value, low, high) in values.items():
        need(all(map(_is_number, (value, low, high))))
        found[str(name)] = float(value), float(low), float(high)
    return found


def need(is_right: bool) -> None:
    """Raise ValueError if something in the folder of a study is not as this version writes it."""
    if not is_right:
        raise ValueError("not of this version")


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def planned_run(values: Mapping[str, Any]) -> PlannedRun:
    """Return a planned run as JSON keeps it. Raises TypeError, KeyError or ValueError where it is none."""
    own = dict(values)
    own["kind"] = RunKind(own["kind"])
    run = PlannedRun(**own)
    need(isinstance(run.settings, dict) and all(map(_is_count, _counts(run))))
    return run


def _counts(run: PlannedRun) -> tuple[object, ...]:
    return (run.number, run.point, run.replicate, run.block, run.seed, run.tool)


def is_run_of(run: PlannedRun, factors: Sequence[FactorInfo]) -> bool:
    """Return whether a run has a value of each factor, and numbers that can be."""
    return (
        all(map(_is_count, _counts(run)))
        and run.settings.keys() == {factor.key for factor in factors}
        and all(is_within(factor, run.settings[factor.key]) for factor in factors)
    )
