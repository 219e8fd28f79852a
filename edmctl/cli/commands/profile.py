"""`edmctl profile`: list, check, show, copy and describe profiles."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import SetOption, SetupOption, argument, command, command_group, option
from edmctl.cli.outcome import Outcome, diagnostics_of
from edmctl.cli.render.terminal import Style
from edmctl.errors import Diagnostic, EdmError, ProfileError
from edmctl.files import read_bytes
from edmctl.jsonout import to_json_value
from edmctl.profile.folders import as_value, find_profile, is_path

if TYPE_CHECKING:
    from edmctl.planning.rules.load import LoadedProfile
    from edmctl.profile.setup import Setup

app = command_group("List, check, show and copy profiles, and write their schema.")

FilesArgument = Annotated[
    list[str], argument("NAME|FILE...", "Files, or shipped names.", autocompletion=completion.profiles)
]
FileArgument = Annotated[
    str, argument("NAME|FILE", "A file, or a shipped name.", autocompletion=completion.profiles)
]
NewFileArgument = Annotated[Path, argument("FILE", "File to write; it must not exist yet.")]
FromOption = Annotated[
    str,
    option(
        "--from NAME",
        "Shipped profile to copy; `profile list` lists them.",
        autocompletion=completion.profiles,
    ),
]


@app.command()
@command("profile check")
def check(
    outcome: Outcome, profiles: FilesArgument, overrides: SetOption = None, setup: SetupOption = None
) -> None:
    """Check profiles; report every problem.

    With --setup they are checked for that machine.
    """
    from edmctl.profile.setup import load_setup

    verdicts: list[dict[str, object]] = []
    outcome.result = {"profiles": verdicts}
    problems: list[Diagnostic] = []
    machine = load_setup(setup)
    for name in profiles:
        found = _problems_of(name, overrides or [], machine)
        errors = sum(not d.is_warning for d in found)
        warnings = len(found) - errors
        verdicts.append({"profile": name, "ok": not errors, "errors": errors, "warnings": warnings})
        problems += found
        if not errors:
            outcome.text += f"{name}: ok\n"
    outcome.text = outcome.text.rstrip("\n")
    if any(not d.is_warning for d in problems):
        raise ProfileError(tuple(problems))
    outcome.warn(problems)


@app.command()
@command("profile show")
def show(outcome: Outcome, profile: FileArgument, overrides: SetOption = None) -> None:
    """Show every value of a profile.

    The output is a profile. Values that the profile does not state are commented out: defaults, and values that
    follow from others, such as the removal of a material.
    """
    from edmctl.planning.rules.load import load_profile

    loaded = load_profile(profile, overrides or [])
    outcome.warn(loaded.warnings)
    outcome.result = _values(loaded)
    outcome.show(lambda style: _as_toml(loaded, style))


@app.command()
@command("profile new")
def new(outcome: Outcome, file: NewFileArgument, shipped: FromOption) -> None:
    """Copy a shipped profile, with its comments, into a new file."""
    from edmctl.jobs.output_files import write

    if is_path(shipped):
        raise failures.template_is_a_file(shipped=shipped)
    write(file, read_bytes(find_profile(shipped)))
    outcome.result = {"file": str(file), "from": shipped}
    value = shlex.quote(as_value(file))
    outcome.text = f"Wrote {file}. Edit it, then check it: `edmctl profile check {value}`"


@app.command("list")
@command("profile list")
def list_shipped(outcome: Outcome, setup: SetupOption = None) -> None:
    """List the shipped profiles, and what each would take.

    With --setup on that machine.
    """
    from edmctl.cli.render.profile_tables import render_profiles
    from edmctl.planning.rules.load import summaries
    from edmctl.profile.setup import load_setup

    found = summaries(load_setup(setup))
    outcome.result = {"profiles": found}
    outcome.show(lambda style: render_profiles(found, style))


@app.command()
@command("profile schema")
def schema(outcome: Outcome) -> None:
    """Write the JSON schema of profiles.

    With --json it is the `result` of the usual object.
    """
    from edmctl.profile.model import profile_schema

    outcome.result = profile_schema()
    outcome.text = json.dumps(to_json_value(outcome.result), indent=2, ensure_ascii=False)


def _problems_of(name: str, overrides: list[str], setup: "Setup") -> list[Diagnostic]:
    from edmctl.planning.rules.load import load_profile

    try:
        return list(load_profile(name, overrides, setup).warnings)
    except EdmError as error:
        return list(diagnostics_of(error))


def _values(loaded: "LoadedProfile") -> dict[str, Any]:
    tables = loaded.profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {**tables, "sim": loaded.sim.model_dump(mode="json", exclude_none=True)}


def _as_toml(loaded: "LoadedProfile", style: Style) -> str:
    from edmctl.cli.render.profile_tables import render_toml

    origin = [f"# {loaded.path.name}", *(f"# {override}" for override in loaded.overrides)]
    shown = render_toml(_values(loaded), loaded.stated, _descriptions(loaded), style)
    return "\n".join(origin) + "\n\n" + shown


def _descriptions(loaded: "LoadedProfile") -> dict[str, str]:
    profile = loaded.profile
    tables = [*dict(profile).items(), ("sim", loaded.sim), *(("sites", site) for site in profile.sites)]
    return {
        f"{name}.{info.alias or field}": info.description or ""
        for name, table in tables
        for field, info in getattr(type(table), "model_fields", {}).items()
    }
