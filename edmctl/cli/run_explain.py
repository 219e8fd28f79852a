"""`edmctl run`: look at run files. `explain` tells what a run did, and why."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import DebugOption, JsonOption
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style

if TYPE_CHECKING:
    from edmctl.console.story import Sentence
    from edmctl.record.reader import RunFile

app = typer.Typer(help="Look at run files.", rich_markup_mode=None, add_completion=False)

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A run file, also one of a run that was killed (.h5.partial).")
]


@app.callback()
def run() -> None:
    """Look at run files."""


@app.command()
def explain(file: FileArgument, as_json: JsonOption = False, debug: DebugOption = False) -> int:
    """Tell the story of a run in plain sentences: what it did, when, and why."""

    def body(outcome: Outcome) -> None:
        from edmctl.console.story import render_story
        from edmctl.record.reader import open_run

        with open_run(file) as opened:
            outcome.run_file = file
            outcome.simulated = opened.number("/entry/simulated") == 1.0
            told = sentences_of(opened)
        outcome.result = {"story": told}
        outcome.text = render_story(told, stream_style(sys.stdout))

    return run_command(Output("run explain", as_json, debug=debug), body)


@dataclass(frozen=True, slots=True)
class FileEvent:
    """An event as the file holds it, its code by name."""

    time_s: float
    code: str
    level: int
    message: str
    args: dict[str, object]


def sentences_of(opened: "RunFile") -> "list[Sentence]":
    """The story of an open run file, from what was wanted to what ended it."""
    from edmctl.console.story import Sentence, story

    events = events_of(opened)
    last_s = max((event.time_s for event in events), default=0.0)
    period_s = opened.profile_values().get("jump.period_s", 0.0)
    told = [Sentence(0.0, _wanted(opened), "WANTED"), *story(events, float(period_s))]
    return [*told, Sentence(last_s, _ended(opened), "END")]


def events_of(opened: "RunFile") -> list[FileEvent]:
    """Every event of the file, in the order in which they were written."""
    from edmctl.machine.port import EventCode
    from edmctl.procedures.codes import RunEvent

    names = {int(code): code.name for code in (*EventCode, *RunEvent)}
    found = []
    for row in opened.table("/entry/events"):
        code = int(row["code"])
        name = names.get(code, str(code))
        args = json.loads(row["args"] or b"{}")
        if name == RunEvent.ENDED_EARLY.name and not args.get("hint"):
            args["hint"] = _hint_of(str(args.get("code", "")))
        message = row["message"].decode(errors="ignore")
        found.append(FileEvent(float(row["time"]), name, int(row["level"]), message, args))
    return found


def _hint_of(error_code: str) -> str:
    """What the row of a fault advises, where the run's own advice was too long for the file."""
    from edmctl.link.faults import FAULTS

    return next((row.hint for row in FAULTS.values() if row.error == error_code), "")


def _wanted(opened: "RunFile") -> str:
    values = opened.profile_values()
    kind = values.get("target.kind")
    objective = {
        "depth": f"a depth of {values.get('target.depth_um', 0):g} ± {values.get('target.tolerance_um', 0):g} µm",
        "feed": f"a feed of {values.get('target.feed_um', 0):g} µm",
        "through": f"a hole through the sheet of {values.get('work.thickness_um', 0):g} µm",
    }.get(str(kind), "no objective that this version knows")
    tool = f"{values.get('tool.material', '?')} tool of {values.get('tool.diameter_um', 0):g} µm"
    jumps = {"off": "without jumps", "fixed": f"with a jump every {values.get('jump.period_s', 0):g} s"}
    how = jumps.get(str(values.get("jump.mode")), "with adaptive jumps")
    title = opened.text("/entry/title") or str(values.get("meta.name", ""))
    return f"{title}: wanted was {objective} in {values.get('work.material', '?')} with a {tool}, {how}."


def _ended(opened: "RunFile") -> str:
    if not opened.is_finished:
        return (
            "The file has no end: the program that wrote it was killed, or is still running. "
            "What is above is what had reached the disk."
        )
    exit_code = int(opened.number("/entry/exit_code"))
    summary = opened.summary() or {}
    machining_s, time_s = summary.get("machining_time_s"), summary.get("time_s")
    took = ""
    if isinstance(time_s, int | float) and isinstance(machining_s, int | float):
        from edmctl.console.text import duration

        took = f" after {duration(time_s)}, {duration(machining_s)} of them machining"
    if exit_code == 0:
        return f"The run came to its end{took}."
    return f"The run ended with exit code {exit_code} ({opened.text('/entry/status')}){took}."
