"""What the lines of a ledger come to: the holes in a machine's work, and the length of each of its tools."""

from __future__ import annotations

import math
from collections.abc import Iterable

from edmctl.dataclasses import dataclass, field, replace
from edmctl.record.ledger import (
    UNFINISHED,
    JobBegun,
    Line,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
    ToolNamed,
    WearMeasured,
    from_home_um,
)

SAME_PLACE_UM = 1.0
"""Two holes of one name so close together are one hole that was taken up again: what a stage repeats to."""


@dataclass(slots=True)
class ToolAccount:
    """One tool: its reference, where it would touch the pad now, what it has made, and lost by that.

    `pad_um` counts from the tool's home at 0 V, NaN before the first touch. `holes` are all of the tool, `since`
    those after its reference;
    `lost_before_um` is what it lost up to then. `reference_utc_s` and `reference_bench_s` are when, as in `Line`.
    `killed` are its jobs since its last touch that never ended: what they cost it nobody knows. `replaced_by` is the
    tool for which it was taken out of the machine after its last reference, "" if it was not: clamped again, it has
    another length, so `reference` is None and `pad_um` NaN then.
    """

    label: str
    reference: ReferenceTouched | None = None
    reference_utc_s: float = math.nan
    reference_bench_s: float = math.nan
    pad_um: float = math.nan
    lost_before_um: float = 0.0
    holes: list[SiteMachined] = field(default_factory=list)
    since: list[SiteMachined] = field(default_factory=list)
    killed: list[JobBegun] = field(default_factory=list)
    replaced_by: str = ""

    @property
    def worn_um(self) -> float:
        """Sum of the wears since the reference."""
        return math.fsum(_known(hole.wear_um) for hole in self.since)

    @property
    def worn_u95_um(self) -> float:
        """Half-width of its 95 % interval; holes that were left without any estimate are not in it."""
        return math.hypot(*(_known(hole.wear_u95_um) for hole in self.since))

    @property
    def lost_um(self) -> float:
        """Sum of the wears since the tool was new."""
        return self.lost_before_um + self.worn_um


@dataclass(frozen=True, slots=True)
class HomeSeen:
    """What the sensor showed of a tool at home when the pad was touched, and when, as in `Line`."""

    um: float
    utc_s: float
    bench_s: float


@dataclass(slots=True)
class MachineHistory:
    """One machine: its holes, its tools, the tool last in use ("" before the first).

    `homes` are all that were seen of the tool's home, the newest last. `reference` is the last of any tool.
    """

    holes: list[SiteMachined] = field(default_factory=list)
    tools: dict[str, ToolAccount] = field(default_factory=dict)
    tool: str = ""
    homes: list[HomeSeen] = field(default_factory=list)
    reference: ReferenceTouched | None = None

    def account(self, label: str) -> ToolAccount:
        """The account of a tool, a new one where nothing is known of it."""
        return self.tools.setdefault(label, ToolAccount(label))


def history_of(lines: Iterable[Line], serial: str) -> MachineHistory:
    """Replay the lines of the machine with that serial number.

    Places of a job whose end was never written count as holes of unknown depth: nobody knows how far it came.
    """
    history, open_jobs = MachineHistory(), dict[str, JobBegun]()
    for line in lines:
        if line.serial != serial:
            continue
        entry = line.entry
        if not isinstance(entry, RunEnded):
            _take_tool(history, entry.before if isinstance(entry, ToolNamed) else entry.tool)
            history.tool = entry.tool
        if isinstance(entry, ReferenceTouched | SiteMachined | WearMeasured) and math.isfinite(entry.home_um):
            history.homes.append(HomeSeen(entry.home_um, line.utc_s, line.bench_s))
        if isinstance(entry, ToolChanged):
            history.tools[entry.tool] = ToolAccount(entry.tool)
        elif isinstance(entry, ToolNamed):
            history.tools[entry.tool] = replace(history.account(entry.before), label=entry.tool)
            del history.tools[entry.before]
        elif isinstance(entry, ReferenceTouched):
            _take_reference(history, entry, line)
        elif isinstance(entry, JobBegun):
            open_jobs[entry.run_file] = entry
            history.account(entry.tool).killed.append(entry)
        elif isinstance(entry, SiteMachined):
            _take_site(history, entry)
        elif isinstance(entry, WearMeasured):
            account = history.account(entry.tool)
            account.pad_um = from_home_um(entry.z_um, entry.home_um)
            account.killed.clear()
        else:
            ended = open_jobs.pop(entry.run_file, None)
            if ended is not None:
                history.account(ended.tool).killed.clear()
    for job in open_jobs.values():
        for name, x_um, y_um in job.places:
            if not any(_same(hole, name, x_um, y_um) for hole in history.holes):
                history.holes.append(_unknown(job, name, x_um, y_um))
    return history


def _take_tool(history: MachineHistory, tool: str) -> None:
    """Drop the reference of the tool that was in the machine if `tool` is another one."""
    if history.tool in ("", tool):
        return
    account = history.account(history.tool)
    account.reference, account.pad_um, account.replaced_by = None, math.nan, tool
    account.lost_before_um = account.lost_um
    account.since.clear()


def _take_reference(history: MachineHistory, entry: ReferenceTouched, line: Line) -> None:
    account = history.account(entry.tool)
    history.reference = account.reference = entry
    account.replaced_by = ""
    account.reference_utc_s, account.reference_bench_s = line.utc_s, line.bench_s
    account.lost_before_um = account.lost_um
    account.pad_um = from_home_um(entry.z_um, entry.home_um)
    account.since.clear()
    account.killed = [job for job in account.killed if job.run_file == entry.run_file]


def _take_site(history: MachineHistory, entry: SiteMachined) -> None:
    """Add a hole; one that was taken up again stands in the place of its first part, wear and all.

    A job that was resumed writes once more what it had measured before; that changes nothing of the tool.
    """
    account = history.account(entry.tool)
    worn_before_um = account.lost_um
    earlier = [hole for hole in account.holes if _same(hole, entry.name, entry.x_um, entry.y_um)]
    if entry.status != UNFINISHED and any(_found(hole) == _found(entry) for hole in earlier):
        return
    for old in earlier:
        if old not in account.since:
            account.lost_before_um -= _known(old.wear_um)
    for holes in (history.holes, account.holes, account.since):
        holes[:] = [hole for hole in holes if not _same(hole, entry.name, entry.x_um, entry.y_um)]
        holes.append(entry)
    touched = not math.isnan(entry.z3_um)
    if touched:
        account.pad_um = from_home_um(entry.z3_um, entry.home_um)
    else:
        account.pad_um += account.lost_um - worn_before_um


def _found(hole: SiteMachined) -> tuple[str, float, float]:
    return hole.status, _known(hole.depth_um), _known(hole.wear_um)


def _known(value: float) -> float:
    return 0.0 if math.isnan(value) else value


def _same(hole: SiteMachined, name: str, x_um: float, y_um: float) -> bool:
    return hole.name == name and math.hypot(hole.x_um - x_um, hole.y_um - y_um) <= SAME_PLACE_UM


def _unknown(job: JobBegun, name: str, x_um: float, y_um: float) -> SiteMachined:
    return SiteMachined(
        tool=job.tool,
        run_file=job.run_file,
        name=name,
        x_um=x_um,
        y_um=y_um,
        radius_um=job.radius_um,
        status=UNFINISHED,
        depth_um=math.nan,
        wear_um=math.nan,
    )
