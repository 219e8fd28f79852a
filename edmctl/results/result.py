"""What a job, a procedure or a calibration came to, as programs and notebooks see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from edmctl.errors import EdmError, installing
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.wording import facts

if TYPE_CHECKING:
    import pandas


MOST_FACTS = 4
"""As many values stand in a short representation."""


class Result:
    """Base of all results: a short representation, a table in a notebook, plain values, a frame of pandas."""

    __slots__ = ()

    error: EdmError | None
    """What ended it early, None where it came to its end."""

    def as_mapping(self) -> Mapping[str, object]:
        """Return the `result` of the JSON object."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, JsonValue]:
        """Return the same values as `--json` tells under `result`, rounded alike."""
        return {name: to_json_value(value, name) for name, value in self.as_mapping().items()}

    def rows(self) -> list[JsonValue]:
        """Return the rows of the result's table: one, unless it is a series of alike things."""
        return [self.to_dict()]

    def to_frame(self) -> pandas.DataFrame:
        """Return the rows as a frame, with units in the names of the columns. Raises ImportError without pandas."""
        return need_pandas().json_normalize(self.rows(), sep="_")

    def raise_for_error(self) -> None:
        """Raise the error that ended it, if one did."""
        if self.error is not None:
            raise self.error

    def brief(self) -> list[str]:
        """Return the words of the short representation."""
        return [f"{name} {value}" for name, value in facts(self.as_mapping())][:MOST_FACTS]

    def __repr__(self) -> str:
        words = [*self.brief(), *([f"{self.error.code}: {self.error.message}"] if self.error else [])]
        return f"<{type(self).__name__}: {', '.join(words) or 'nothing reached'}>"

    def _repr_html_(self) -> str:
        """The rows as a table for a notebook; a single one with a line a value."""
        rows = [dict(facts(row)) for row in self.rows() if isinstance(row, Mapping)]
        if len(rows) == 1:
            return html_table((), [*rows[0].items()], self.error)
        head = tuple(dict.fromkeys(name for row in rows for name in row))
        return html_table(head, [[row.get(name, "") for name in head] for row in rows], self.error)


def need_pandas() -> Any:
    """Return the package of frames. Raises ImportError with the command that installs it."""
    try:
        import pandas as pd
    except ImportError as error:
        message = f"A frame needs pandas, which is not installed: {installing('pandas')}."
        raise ImportError(message, name="pandas") from error
    return pd


def html_table(head: Sequence[str], lines: Sequence[Sequence[str]], error: EdmError | None) -> str:
    """Return a table for a notebook, with the error below it."""
    cells = [*([("th", head)] if head else []), *(("td", line) for line in lines)]
    rows = (f"<tr>{''.join(f'<{tag}>{escape(text)}</{tag}>' for text in line)}</tr>" for tag, line in cells)
    below = f"<p>{escape(error.code)}: {escape(error.message)}</p>" if error else ""
    return f"<table>{''.join(rows)}</table>{below}"
