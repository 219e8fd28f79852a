"""`KEY=START:STOP:COUNT`: one profile value in equal steps."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from edmctl.errors import UsageError

_FORM = re.compile(r"(?P<key>[A-Za-z0-9_.-]+)=(?P<start>[^:]+):(?P<stop>[^:]+):(?P<count>[^:]+)")
_MOST = 1000


@dataclass(frozen=True, slots=True)
class Sweep:
    """A key and its values, as `--set` takes them."""

    key: str
    values: tuple[str, ...]

    def overrides(self) -> tuple[str, ...]:
        """Return one `KEY=VALUE` per value."""
        return tuple(f"{self.key}={value}" for value in self.values)


def parse_sweep(text: str) -> Sweep:
    """Parse `KEY=START:STOP:COUNT`; both ends are included. Raises UsageError (E2003).

    Whole ends that are whole steps apart give whole numbers, for keys that take no others.
    """
    match = _FORM.fullmatch(text)
    if not match:
        raise _refused(text, "is not of the form KEY=START:STOP:COUNT")
    try:
        start, stop, count = float(match["start"]), float(match["stop"]), int(match["count"])
    except ValueError:
        raise _refused(text, "START and STOP must be numbers and COUNT a whole number") from None
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(stop - start)):
        raise _refused(text, "START and STOP must be finite")
    if not 2 <= count <= _MOST:
        raise _refused(text, f"COUNT must be 2 to {_MOST}")
    step = (stop - start) / (count - 1)
    whole = all(re.fullmatch(r"[+-]?\d+", match[name]) for name in ("start", "stop")) and step.is_integer()
    values = (start + index * step for index in range(count))
    written = tuple(str(int(v)) if whole else repr(float(f"{v:.12g}")) for v in values)
    if len(set(written)) < count:
        raise _refused(text, "its values must differ")
    return Sweep(match["key"], written)


def _refused(text: str, reason: str) -> UsageError:
    return UsageError(
        f"--sweep {text!r}: {reason}.", hint="An example: --sweep servo.reference=0.70:0.90:5", code="E2003"
    )
