"""TOML files with a hash of their content: written whole or not at all, checked when they are read."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from edmctl.dataclasses import dataclass
from edmctl.errors import Location, ProfileError, RecordError, RunFileError
from edmctl.files import replace_file
from edmctl.profile.positions import Sources
from edmctl.profile.read import parse, read_source
from edmctl.profile.tables import Table

HASH = "sha256"


class HashedTable(Table):
    """The content of such a file, without its hash."""

    @property
    def sha256(self) -> str:
        """Hash of the content, as written in the file."""
        return content_hash(self.table())

    def table(self) -> dict[str, object]:
        """Return the content as TOML holds it, without the hash."""
        return self.model_dump(by_alias=True, exclude_none=True)


T = TypeVar("T", bound=HashedTable)


def content_hash(table: Mapping[str, object]) -> str:
    """SHA-256 of a table as JSON: keys sorted, no spaces, ASCII, numbers as short as they are read back exactly."""
    canonical = json.dumps(table, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of file: its name in messages, its schemas, and the hint how to get a valid one.

    `codes` are those of a file that cannot be read, is no TOML, has another schema, was edited, or holds impossible
    values; `write_code` that of one that cannot be written.
    """

    name: str
    schemas: tuple[str, ...]
    again: str
    missing: str
    codes: tuple[str, str, str, str, str]
    write_code: str

    def load(self, path: Path, model: type[T], check: Callable[[T], object]) -> T:
        """Read and check a file; `check` raises ValueError for impossible values. Raises RecordError."""
        unreadable, no_toml, other_schema, edited, impossible = self.codes

        def refusal(code: str, message: str, hint: str = "", where: Location | None = None) -> RecordError:
            return RecordError(f"{message}.", hint=hint or self.again, code=code, where=where)

        try:
            source = read_source(path)
        except (ProfileError, ValueError) as error:
            message = error.message if isinstance(error, ProfileError) else f"cannot read {path}: {error}"
            raise refusal(unreadable, message, self.missing.format(path=path)) from error
        try:
            table = parse(source)
        except ProfileError as error:
            message = f"{path} is no {self.name}: {error.message}"
            raise refusal(no_toml, message, where=error.where) from error

        place = Sources((source,), source).value
        schema = table.get("schema")
        if schema not in self.schemas:
            stem = self.schemas[0].rpartition("/")[0]
            if isinstance(schema, str) and re.fullmatch(rf"{stem}/\d+", schema):
                reads = " and ".join(self.schemas)
                message = f"{path} has the schema {schema}, and this edmctl reads {reads}"
                hint = f"Update edmctl, or {self.again[0].lower()}{self.again[1:]}"
            else:
                message = f"{path} is no {self.name}"
                hint = f"A {self.name} says schema = {json.dumps(self.schemas[0])}. {self.again}"
            raise refusal(other_schema, message, hint, place(("schema",)))
        if table.pop(HASH, None) != content_hash(table):
            message = f"{path} was edited or damaged: its content does not have the hash that it says"
            raise refusal(edited, message, where=place((HASH,)))
        try:
            content = model.model_validate(table)
            check(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(part) for part in first["loc"])
            raise refusal(impossible, f"{path}: {key}: {first['msg']}", where=place(first["loc"])) from None
        except ValueError as error:
            raise refusal(impossible, f"{path}: {error}", where=place(("model",))) from None
        return content

    def save(self, path: Path, content: HashedTable) -> None:
        """Write a file in the place of what was there; make its folder. Raises RunFileError."""
        import tomli_w  # only writing needs it

        table = content.table()
        text = tomli_w.dumps({"schema": table.pop("schema"), HASH: content.sha256, **table})
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, text.encode())
        except OSError as error:
            raise RunFileError(
                f"Cannot write the {self.name} {path}: {error.strerror or error}.",
                hint="Check that its folder can be written and has space, or name another file with --output.",
                code=self.write_code,
            ) from error
