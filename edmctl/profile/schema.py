"""JSON schema of a profile file, for editors."""

from __future__ import annotations

from typing import Any

from edmctl.profile.sim import ProfileFile


def profile_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a profile file. One that extends another may leave any key to that."""
    schema = ProfileFile.model_json_schema(by_alias=True)
    required = {"required": schema.pop("required"), "properties": _required_keys(schema)}
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "profile whose values hold where this one states none, relative to this file, or shipped",
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "edmctl machining profile",
        "if": {"not": {"required": ["extends"]}},
        "then": required,
    }


def _required_keys(schema: dict[str, Any]) -> dict[str, Any]:
    """Take the required keys out of the tables' definitions: for each table, what it must hold.

    Items of a list keep theirs, because a list is inherited whole or not at all.
    """
    found = {}
    for table, description in schema["properties"].items():
        kinds = description.get("oneOf", description.get("anyOf", [description]))
        names = [kind["$ref"].rpartition("/")[2] for kind in kinds if "$ref" in kind]
        if names:
            taken = [schema["$defs"][name].pop("required", []) for name in names]
            found[table] = {"anyOf": [{"required": keys} for keys in taken]}
    return found
