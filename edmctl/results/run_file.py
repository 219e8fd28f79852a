"""What run files hold: of each hole, of a whole run, one run of a folder, and runs side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path

from edmctl.dataclasses import asdict, astuple, dataclass, field, fields
from edmctl.errors import RunFileError
from edmctl.labels import basis_of, weakest
from edmctl.results.declared import quantities
from edmctl.results.job import SiteResult, SiteTruth
from edmctl.results.telemetry import PULSE_CLASSES, PulseShares


@dataclass(frozen=True, slots=True)
class RunHead:
    """One run file of a folder. Depth and wear are means of its sites; unknown values are NaN, None or empty.

    Without sites they are those of `measure-wear`. `est_depth_um` is that of an abandoned hole; `through` counts
    holes through a sheet. Bases are the weakest of the sites, `verdict` is the worst. `status` is `running` while
    the writer lives and `interrupted` if it was killed.
    """

    path: Path
    size_bytes: int
    run_id: str
    parent_run: str
    name: str
    title: str
    start_time: str
    end_time: str
    status: str
    exit_code: int | None
    error_code: str
    simulated: bool
    seed: int | None
    work: str
    tool: str
    sites: int
    through: int
    depth_um: float
    depth_u95_um: float
    est_depth_um: float
    est_depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    machining_time_s: float
    depth_basis: str
    wear_basis: str
    verdict: str


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A file of a folder that is no run file that this version can read, and why."""

    path: Path
    size_bytes: int
    changed_s: float
    error: RunFileError


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSite(SiteResult):
    """A hole or channel as a run file has it; `length_um` is its depth, or the thickness of the sheet."""

    length_um: float = math.nan
    truth: SiteTruth = field(default_factory=SiteTruth)

    def as_mapping(self) -> dict[str, object]:
        """Return what `run show --json` prints."""
        values: dict[str, object] = {name: getattr(self, name) for name in quantities(SiteResult)}
        values |= {name: values[name] or "" for name in ("depth_basis", "verdict")}
        truth = {f"truth_{name}": value for name, value in asdict(self.truth).items()}
        return values | {"ratios": astuple(self.ratios), "length_um": self.length_um} | truth


class Sites(tuple[RecordedSite, ...]):
    """The holes of a run, or its channel, with their sums and means. Unknown values are NaN.

    The uncertainty of a mean is the mean uncertainty: errors of one run have causes in common, and do not cancel.
    """

    __slots__ = ()

    def mean(self, name: str) -> float:
        """Return the mean of a field, such as `depth_um` or `truth.depth_um`."""
        return math.fsum(map(attrgetter(name), self)) / len(self) if self else math.nan

    def total(self, name: str) -> float:
        """Return the sum of a field."""
        return math.fsum(map(attrgetter(name), self)) if self else math.nan

    def basis(self, name: str) -> str:
        """Return the basis of the value `name` over all sites: the weakest of theirs (`basis_of`)."""
        return weakest(basis_of(name, site.depth_basis, site.wear_basis) for site in self)

    @property
    def totals(self) -> Totals:
        """Sums over the sites, and rates and ratios of them."""
        pulses, length_um = self.total("pulses"), self.total("length_um")
        removed = [site.mrr_mm3_min * site.machining_time_s for site in self]
        lost = [site.wear_ratio_vol * volume for site, volume in zip(self, removed, strict=True)]
        # The wear of a channel has nothing to do with its depth alone.
        is_linear = all(math.isfinite(site.wear_ratio_lin) for site in self)
        shares = (
            math.fsum(getattr(site.ratios, name) * site.pulses for site in self if site.pulses)
            for name in PULSE_CLASSES
        )
        return Totals(
            pulses=int(pulses) if self else 0,
            ratios=PulseShares(*(_ratio(share, pulses) for share in shares)),
            energy_j=self.total("energy_j"),
            mrr_mm3_min=_ratio(math.fsum(removed), self.total("machining_time_s")),
            wear_ratio_lin=_ratio(self.total("wear_um"), length_um) if is_linear else math.nan,
            wear_ratio_vol=_ratio(math.fsum(lost), math.fsum(removed)),
        )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan


@dataclass(frozen=True, slots=True)
class JumpTimes:
    """Every jump of the tool, and the times between those of one cut, s; NaN with fewer than two."""

    count: int
    shortest_s: float
    median_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class Totals:
    """Sums over all sites; unknown values are NaN."""

    pulses: int
    ratios: PulseShares
    energy_j: float
    mrr_mm3_min: float
    wear_ratio_lin: float
    wear_ratio_vol: float


@dataclass(frozen=True, slots=True)
class FileEvent:
    """An event as the file holds it, its code by name."""

    time_s: float
    code: str
    level: int
    message: str
    args: dict[str, object]


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence about a run; `code` names the kind of event that it describes."""

    time_s: float
    text: str
    code: str


@dataclass(frozen=True, slots=True)
class RunSummary:
    """Everything that `run show` shows; `rows` are those of each table, `summary` is the result of the command.

    Times are those of the job, also in earlier runs (`earlier_time_s`), without the pauses (`pause_s`, NaN if
    unknown). `way_on` is the command that resumes it, if any. `est_depth_um` is the depth of an abandoned hole, if
    any.
    """

    file: str
    size_bytes: int
    run_id: str
    parent_run: str
    title: str
    wanted: str
    command: tuple[str, ...]
    user: str
    start_time: str
    end_time: str
    status: str
    exit_code: int | None
    error_code: str
    recovery: str
    way_on: str
    simulated: bool
    seed: int | None
    time_s: float
    machining_time_s: float
    earlier_time_s: float
    pause_s: float
    sites: Sites
    est_depth_um: float
    est_depth_u95_um: float
    totals: Totals
    jumps: JumpTimes
    touches: tuple[dict[str, object], ...]
    moments: tuple[Sentence, ...]
    warnings: tuple[Sentence, ...]
    machine: dict[str, str]
    software: dict[str, str]
    profile: dict[str, object]
    overrides: tuple[str, ...]
    rows: dict[str, int]
    summary: dict[str, object] | None

    def as_mapping(self) -> dict[str, object]:
        """Return what `run show --json` prints."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return values | {"sites": [site.as_mapping() for site in self.sites]}


@dataclass(frozen=True, slots=True)
class Exported:
    """One table that became a file."""

    table: str
    path: str
    rows: int
    size_bytes: int
    columns: Sequence[str]


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A run of the comparison."""

    file: str
    run_id: str
    title: str
    start: str
    status: str
    simulated: bool
    seed: int | None
    sites: int


@dataclass(frozen=True, slots=True)
class Setting:
    """Something that is not the same in all runs; `values` has one text a run, empty where a run has none."""

    key: str
    units: str
    values: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Amount:
    """A quantity in one run, and against the first run; unknown values are NaN.

    `difference_u95` combines both uncertainties; `beyond`: the difference exceeds it. `basis` is of depths and
    wears.
    """

    value: float
    u95: float
    difference: float
    difference_u95: float
    beyond: bool
    basis: str = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity in every run, in the unit of `key`; what is shown under `name` is `factor` times that."""

    key: str
    name: str
    decimals: int
    factor: float
    amounts: tuple[Amount, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Several runs; `sites` has the depths and wears of places that all of them have, where there are several."""

    runs: tuple[ComparedRun, ...]
    differs: tuple[Setting, ...]
    quantities: tuple[Quantity, ...]
    sites: tuple[Quantity, ...]
