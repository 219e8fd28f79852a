"""Rules that are declared: one value of a profile is bounded, or values exclude each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Self

from edmctl.dataclasses import dataclass, field, replace
from edmctl.failures import Code
from edmctl.planning.forecast import Job
from edmctl.profile.findings import Finding, rounded_down, rounded_up
from edmctl.profile.model import Profile


class _Values(dict[str, object]):
    """Values by name, and the tables of a profile."""

    def __init__(self, profile: Profile, **values: object) -> None:
        super().__init__(values)
        self._profile = profile

    def __missing__(self, table: str) -> object:
        return getattr(self._profile, table)


@dataclass(frozen=True, slots=True)
class _Declared:
    code: Code
    key: str
    message: str = field(default="", kw_only=True)
    hint: str = field(default="", kw_only=True)

    def says(self, message: str, hint: str) -> Self:
        """Return the rule with its texts, which may name keys of the profile: `{work.thickness_um:g}`."""
        return replace(self, message=message, hint=hint)

    def _finding(self, profile: Profile, **values: object) -> Finding:
        named = _Values(profile, **values)
        path = tuple(self.key.split("."))
        return Finding(self.code, path, self.message.format_map(named), self.hint.format_map(named))


@dataclass(frozen=True, slots=True)
class Conflict(_Declared):
    """Values of a profile that exclude each other."""

    is_violated: Callable[[Profile], bool]

    def __call__(self, job: Job) -> Iterator[Finding]:
        """Yield the finding if the rule is violated."""
        if self.is_violated(job.profile):
            yield self._finding(job.profile)


@dataclass(frozen=True, slots=True)
class Bound(_Declared):
    """A value that has to compare with a limit as `holds` states, where the rule applies (`when`).

    The limit is a number, the value of another key, or a function of the job. Texts may also name `{value}`,
    `{limit}`, and the limit rounded up and down to tenths, `{least}` and `{most}`.
    """

    holds: Callable[[float, float], bool]
    limit: float | str | Callable[[Job], float]
    when: Callable[[Profile], bool] = lambda _: True

    def __call__(self, job: Job) -> Iterator[Finding]:
        """Yield the finding if the rule is violated."""
        if not self.when(job.profile):
            return
        value, limit = _value(job.profile, self.key), self.limit
        if not isinstance(limit, float):
            limit = _value(job.profile, limit) if isinstance(limit, str) else limit(job)
        if not self.holds(value, limit):
            least, most = rounded_up(limit), rounded_down(limit)
            yield self._finding(job.profile, value=value, limit=limit, least=least, most=most)


def _value(profile: Profile, key: str) -> float:
    return float(attrgetter(key)(profile))
