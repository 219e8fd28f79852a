"""The recipe of an earlier run, for commands that are given no profile."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError, RunFileError
from edmctl.profile.model import Profile
from edmctl.profile.read import Merged, apply_overrides, put
from edmctl.record.tool_account import ToolAccount

if TYPE_CHECKING:
    from edmctl.jobs.plan import Plan

_LISTS = ("sites", "regimes")
"""Run files keep lists as JSON."""


def last_run_of(account: ToolAccount) -> str:
    """Return the file of the last run with the tool: of its last hole, else of its reference; empty without any."""
    if account.holes:
        return account.holes[-1].run_file
    return account.reference.run_file if account.reference is not None else ""


def with_recipe_of(plan: Plan, folder: Path, run_file: str) -> Plan:
    """Return the plan with the recipe of the run in that file, and `--set` on top, if no profile was named.

    Raises PreconditionError E8063 if the recipe cannot be read.
    """
    from edmctl.record.reader import present_name, reading_unverified

    if plan.names_tool or not run_file:
        return plan
    path = present_name(folder / run_file)
    try:
        with reading_unverified(path) as run:
            values, text = run.profile_values(), run.text("/entry/profile/toml")
            sha256 = run.text("/entry/profile/recipe_sha256")
        table: dict[str, object] = {}
        for key, value in values.items():
            if not key.startswith("sim.") and not key.endswith("_units"):
                table = put(table, tuple(key.split(".")), json.loads(str(value)) if key in _LISTS else value)
        profile = Profile.model_validate(apply_overrides(Merged((), table, ()), plan.request.overrides).table)
    except (RunFileError, ValueError) as error:
        why = (
            error.message if isinstance(error, RunFileError) else "its values are not those of this version."
        )
        raise PreconditionError(
            f"{path} has the recipe that the tool was used with, and cannot be read: {why}",
            hint="Name it with --profile.",
            code="E8063",
        ) from error
    loaded = replace(plan.loaded, profile=profile, text=text, sha256=sha256)
    return replace(plan, loaded=loaded, recipe_of=str(path))
