"""TOML files with a hash of their content: written whole or not at all, checked when they are read."""

import json
import re
from pathlib import Path
from typing import ClassVar, Self

from pydantic import ValidationError

from edmctl.errors import Location, ProfileError, RecordError, RunFileError
from edmctl.files import replace_file
from edmctl.profile.read import Sources, parse, read_source
from edmctl.profile.tables import Table, content_hash

HASH = "sha256"


class HashedTable(Table):
    """The content of such a file, without its hash.

    `codes` are those of a file that cannot be read, is no TOML, has another schema, was edited, has impossible
    values, and of one that cannot be written. `again` and `missing` are remedies, the latter with the {path}.
    """

    kind: ClassVar[str]
    schemas: ClassVar[tuple[str, ...]]
    again: ClassVar[str]
    missing: ClassVar[str]
    codes: ClassVar[tuple[str, str, str, str, str, str]]

    def check(self) -> None:
        """Raise ValueError if values are impossible."""
        raise NotImplementedError

    @property
    def sha256(self) -> str:
        """Hash of the content, as written in the file."""
        return content_hash(self.table())

    def table(self) -> dict[str, object]:
        """Return the content as TOML holds it, without the hash."""
        return self.model_dump(by_alias=True, exclude_none=True)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read and check a file. Raises RecordError."""
        unreadable, no_toml, other_schema, edited, impossible, _ = cls.codes

        def refusal(
            code: str, message: str, hint: str = cls.again, where: Location | None = None
        ) -> RecordError:
            return RecordError(f"{message}.", hint=hint, code=code, where=where)

        try:
            source = read_source(path)
        except (ProfileError, ValueError) as error:
            message = error.message if isinstance(error, ProfileError) else f"cannot read {path}: {error}"
            raise refusal(unreadable, message, cls.missing.format(path=path)) from error
        try:
            table = parse(source)
        except ProfileError as error:
            message = f"{path} is no {cls.kind}: {error.message}"
            raise refusal(no_toml, message, where=error.where) from error
        place, schema = Sources((source,), source).value, table.get("schema")
        if schema not in cls.schemas:
            message = f"{path} is no {cls.kind}"
            hint = f"A {cls.kind} says schema = {json.dumps(cls.schemas[0])}. {cls.again}"
            if isinstance(schema, str) and re.fullmatch(cls.schemas[0].rpartition("/")[0] + r"/\d+", schema):
                message = f"{path} has the schema {schema}; this edmctl reads {' and '.join(cls.schemas)}"
                hint = f"Update edmctl. Or: {cls.again}"
            raise refusal(other_schema, message, hint, place(("schema",)))
        if table.pop(HASH, None) != content_hash(table):
            message = f"{path} was edited or damaged: its content does not have the hash that it states"
            raise refusal(edited, message, where=place((HASH,)))
        try:
            content = cls.model_validate(table)
            content.check()
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(map(str, first["loc"]))
            raise refusal(impossible, f"{path}: {key}: {first['msg']}", where=place(first["loc"])) from None
        except ValueError as error:
            raise refusal(impossible, f"{path}: {error}", where=place(("model",))) from None
        return content

    def save(self, path: Path) -> None:
        """Write the file in the place of what was there; make its folder. Raises RunFileError."""
        import tomli_w  # only writing needs it

        table = self.table()
        text = tomli_w.dumps({"schema": table.pop("schema"), HASH: self.sha256, **table})
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, text.encode())
        except OSError as error:
            raise RunFileError(
                f"Cannot write the {self.kind} {path}: {error.strerror or error}.",
                hint="Check that its folder can be written and has space, or name another file with --output.",
                code=self.codes[-1],
            ) from error
