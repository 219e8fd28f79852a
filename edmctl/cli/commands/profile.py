"""`edmctl profile`: list, check, show and describe profiles."""

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmctl.cli import completion
from edmctl.cli.options import DebugOption, JsonOption, SetOption, SetupOption
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style
from edmctl.errors import Diagnostic, EdmError, ProfileError

if TYPE_CHECKING:
    from edmctl.profile.setup import Setup
    from edmctl.rules.load import LoadedProfile

app = typer.Typer(
    help="List, check, show and describe profiles.",
    rich_markup_mode=None,
    add_completion=False,
)

FilesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="NAME|FILE...", help="Files, or shipped names.", autocompletion=completion.profiles
    ),
]
FileArgument = Annotated[
    str,
    typer.Argument(
        metavar="NAME|FILE", help="A file, or a shipped name.", autocompletion=completion.profiles
    ),
]


@app.command()
def check(
    profiles: FilesArgument,
    overrides: SetOption = None,
    setup: SetupOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> int:
    """Check profiles; report every problem.

    With --setup they are checked for that machine.
    """

    def body(outcome: Outcome) -> None:
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

    return run_command(Output("profile check", json=as_json, debug=debug), body)


@app.command()
def show(
    profile: FileArgument,
    overrides: SetOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> int:
    """Show every value of a profile."""

    def body(outcome: Outcome) -> None:
        from edmctl.rules.load import load_profile

        loaded = load_profile(profile, overrides or [])
        outcome.warn(loaded.warnings)
        outcome.result = _values(loaded)
        outcome.text = _as_toml(loaded)

    return run_command(Output("profile show", json=as_json, debug=debug), body)


@app.command("list")
def list_shipped(setup: SetupOption = None, as_json: JsonOption = False, debug: DebugOption = False) -> int:
    """List the shipped profiles, and what each would take.

    With --setup on that machine.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.console.profile_tables import render_profiles
        from edmctl.profile.setup import load_setup
        from edmctl.rules.load import summaries

        found = summaries(load_setup(setup))
        outcome.result = {"profiles": found}
        outcome.text = render_profiles(found, stream_style(sys.stdout))

    return run_command(Output("profile list", json=as_json, debug=debug), body)


@app.command()
def schema(as_json: JsonOption = False, debug: DebugOption = False) -> int:
    """Write the JSON schema of profiles.

    With --json it is the `result` of the usual object.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.profile.profile_file import profile_schema

        outcome.result = profile_schema()
        outcome.text = json.dumps(outcome.result, indent=2, ensure_ascii=False)

    return run_command(Output("profile schema", json=as_json, debug=debug), body)


def _problems_of(name: str, overrides: list[str], setup: "Setup") -> list[Diagnostic]:
    from edmctl.rules.load import load_profile

    try:
        return list(load_profile(name, overrides, setup).warnings)
    except ProfileError as error:
        return list(error.diagnostics)
    except EdmError as error:
        return [Diagnostic(error.code, error.message, error.hint, error.where)]


def _values(loaded: "LoadedProfile") -> dict[str, Any]:
    tables = loaded.profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {**tables, "sim": loaded.sim.model_dump(mode="json", exclude_none=True)}


def _as_toml(loaded: "LoadedProfile") -> str:
    from edmctl.console.profile_tables import render_toml

    tables = _values(loaded)
    tables["servo"].pop("reference_v", None)  # stated once: loading turned it into `reference`
    origin = [f"# {loaded.path}", *(f"# {override}" for override in loaded.overrides)]
    return "\n".join(origin) + "\n\n" + render_toml(tables, _descriptions(loaded), stream_style(sys.stdout))


def _descriptions(loaded: "LoadedProfile") -> dict[str, str]:
    profile = loaded.profile
    tables = [*dict(profile).items(), ("sim", loaded.sim), *(("sites", site) for site in profile.sites)]
    return {
        f"{name}.{info.alias or field}": info.description or ""
        for name, table in tables
        for field, info in getattr(type(table), "model_fields", {}).items()
    }
