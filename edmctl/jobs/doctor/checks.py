"""What `doctor` found: one check after the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.results.equipment import Check, CheckStatus

if TYPE_CHECKING:
    from edmctl.errors import EdmError


def ok(name: str, message: str) -> Check:
    """A check without a finding."""
    return Check(name, CheckStatus.OK, message)


def warn(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops nothing."""
    return Check(name, CheckStatus.WARN, message, fix)


def fail(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops a job."""
    return Check(name, CheckStatus.FAIL, message, fix)


@dataclass(slots=True)
class Checks:
    """Every check done so far, in order."""

    done: list[Check] = field(default_factory=list)

    def take(self, *checks: Check) -> None:
        """Add checks."""
        self.done += checks

    def fail(self, name: str, error: EdmError) -> None:
        """Add a check that ended with an error."""
        self.done.append(fail(name, error.message, error.hint))

    def as_list(self) -> list[dict[str, str]]:
        """Every check as a mapping of plain values."""
        return [{**dataclasses.asdict(check), "status": check.status.value} for check in self.done]

    def error(self) -> PreconditionError | None:
        """The error of the failed checks; None where none failed."""
        failed = [check.name for check in self.done if check.status is CheckStatus.FAIL]
        if not failed:
            return None
        return PreconditionError(
            f"{len(failed)} of {len(self.done)} checks failed: {', '.join(failed)}.",
            hint="The fix stands beside each of them.",
            code="E8040",
        )
