"""JSON schema of a profile file, for editors."""

from __future__ import annotations

from typing import Any

from edmctl.profile.sim import ProfileFile


def profile_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a profile file."""
    schema = ProfileFile.model_json_schema(by_alias=True)
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "profile whose values hold where this one states none, relative to this file",
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "edmctl machining profile",
    }
