"""Findings of rules, and rules that are declared as the bound of a value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Self, TypeAlias

from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Location
from edmctl.failures import Code
from edmctl.planning.forecast import Job
from edmctl.profile.model import Profile
from edmctl.profile.tables import KeyPath


@dataclass(frozen=True, slots=True)
class Finding:
    """One violated rule, at the value of a key or item, or at a line of a file that it names (`where`)."""

    code: Code
    key: str | KeyPath
    message: str
    hint: str
    where: Location | None = None


Findings: TypeAlias = Iterator[Finding]
Rule: TypeAlias = Callable[[Job], Findings]


def rounded_up(value: float) -> str:
    """Return a lower limit as a hint gives it, rounded up to tenths."""
    return f"{math.ceil(10.0 * value - 1e-9) / 10.0:.6g}"


def rounded_down(value: float) -> str:
    """Return an upper limit as a hint gives it, rounded down to tenths."""
    return f"{math.floor(10.0 * value + 1e-9) / 10.0:.6g}"


class _Values(dict[str, object]):
    """Values by name, and the tables of a profile."""

    def __init__(self, profile: Profile, **values: object) -> None:
        super().__init__(values)
        self._profile = profile

    def __missing__(self, table: str) -> object:
        return getattr(self._profile, table)


@dataclass(frozen=True, slots=True)
class Bound:
    """A value that has to compare with a limit as `holds` states, where the rule applies (`when`).

    The limit is a number, the value of another key, or a function of the job. Texts may name keys of the profile
    (`{work.thickness_um:g}`), `{value}`, `{limit}`, and the limit rounded to tenths, `{least}` up and `{most}` down.
    """

    code: Code
    key: str
    holds: Callable[[float, float], bool]
    limit: float | str | Callable[[Job], float]
    when: Callable[[Profile], bool] = lambda _: True
    message: str = field(default="", kw_only=True)
    hint: str = field(default="", kw_only=True)

    def says(self, message: str, hint: str) -> Self:
        """Return the rule with its texts."""
        return replace(self, message=message, hint=hint)

    def __call__(self, job: Job) -> Findings:
        """Yield the finding if the rule is violated."""
        profile, limit = job.profile, self.limit
        if not self.when(profile):
            return
        value = float(attrgetter(self.key)(profile))
        if not isinstance(limit, float):
            limit = float(attrgetter(limit)(profile)) if isinstance(limit, str) else limit(job)
        if not self.holds(value, limit):
            texts = _Values(
                profile, value=value, limit=limit, least=rounded_up(limit), most=rounded_down(limit)
            )
            yield Finding(self.code, self.key, self.message.format_map(texts), self.hint.format_map(texts))
