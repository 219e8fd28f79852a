"""`edmctl first-start`: the checklist of a newly wired machine, item by item, with a report."""

import queue
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli.options import (
    NOTES,
    ControllerOption,
    PortOption,
    SeedOption,
    SetupOption,
    WaitOption,
    command,
)
from edmctl.cli.outcome import Outcome, mutter, tell
from edmctl.cli.signals import shell
from edmctl.jsonout import render_json

if TYPE_CHECKING:
    from edmctl.board.first_start.person import Act, Asked, Done, Question
    from edmctl.board.results import FirstStartReport, Item
    from edmctl.machine.controller import LinkMachine

AnswersOption = Annotated[
    Path | None,
    typer.Option(
        "--answers", metavar="FILE", help="Take all answers from a TOML file; what it lacks is skipped."
    ),
]
YesOption = Annotated[
    bool, typer.Option("--yes", help="Allow every step. On a virtual machine in this process (sim:) alone.")
]
ActsOption = Annotated[
    Path | None,
    typer.Option(
        "--acts",
        metavar="FILE",
        help="Act on a served virtual machine, by the file of `simulate serve --acts`.",
    ),
]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the report.")]
HOW_TO_STOP = (
    "Ctrl-C stops at any time: pulses off, tool retracted, the report is written; high voltage and amplifier are "
    "yours to switch off.\n"
)
_LOOK_S = 0.05


@command("first-start", NOTES)
def first_start(
    outcome: Outcome,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    seed: SeedOption = None,
    controller: ControllerOption = None,
    answers: AnswersOption = None,
    yes: YesOption = False,
    acts: ActsOption = None,
    out: OutOption = Path("runs"),
) -> None:
    """Check the wiring of a new machine, item by item.

    Starts with everything off, names likely wiring mistakes, requests operator actions, and asks before each step
    that energises something. docs/first-start.md lists every item.
    """
    from dataclasses import replace

    from edmctl.board.first_start.person import ALL_ALLOWED, read_answers
    from edmctl.board.first_start.run import first_start as run
    from edmctl.board.first_start.run import verdict
    from edmctl.jobs.connect import controller_warning, known_controller, seed_warning
    from edmctl.jobs.output_files import check_folder
    from edmctl.jobs.plan import where_is
    from edmctl.jobs.sweep import seed_to_use
    from edmctl.profile.setup import load_setup

    settings = load_setup(setup)
    where = where_is(port, settings, wait)
    if controller is not None:
        where = replace(where, controller=known_controller(controller))
    given = read_answers(answers) if answers is not None else None
    if yes and not where.in_process:
        raise failures.yes_with_real_machine(selector=where.selector)
    if yes and given is not None:
        raise failures.yes_beside_answers()
    if acts is not None and where.in_process:
        raise failures.acts_without_served_machine(selector=where.selector)
    if given is None and not yes and not sys.stdin.isatty():
        raise failures.no_terminal()
    check_folder(out)

    def person(machine: "LinkMachine") -> "Asked":
        return given or (ALL_ALLOWED if yes else Terminal(machine))

    outcome.warn(seed_warning(where, seed))
    outcome.warn(controller_warning(where, controller))
    used = seed_to_use(seed)
    outcome.seed = where.seed_of(used)
    say: Callable[[str], None] = partial(tell, outcome.output)
    report, error = run(settings, where, used, person, acts, lambda item: say(_line(item)), say, shell())
    outcome.simulated = report.simulated
    _leave(outcome, report, out)
    if error or (error := verdict(report)):
        raise error


def _line(item: "Item") -> str:
    told = item.reason or item.read
    lines = [f"{item.status:10}{item.title}{': ' if told else ''}{told}"]
    lines += [f"{'':10}likely: {cause.text}; net {', '.join(cause.nets) or 'none'}" for cause in item.causes]
    return "\n".join(lines)


def _leave(outcome: Outcome, report: "FirstStartReport", out: Path) -> None:
    """Write the report as text and as JSON, and set it as the result."""
    from edmctl.board.commands.tables import render_first_start
    from edmctl.jobs.output_files import make_folder, write

    make_folder(out)
    stem = "first-start-" + "".join(c for c in report.started if c.isalnum())[:15]
    number = next(n for n in range(1, 1000) if not list(out.glob(f"{stem}{_suffix(n)}.*")))
    files = {kind: out / f"{stem}{_suffix(number)}.{kind}" for kind in ("txt", "json")}
    write(files["txt"], (render_first_start(report) + "\n").encode())
    write(files["json"], render_json({"first_start": report}).encode())
    outcome.result = {"first_start": report, "files": [str(path) for path in files.values()]}
    outcome.show(lambda style: render_first_start(report, style))
    outcome.text = f"Report {files['txt']}"


def _suffix(number: int) -> str:
    return "" if number == 1 else f"-{number}"


class Terminal:
    """A person at a terminal. While one is waited for, the controller hears its host, and Ctrl-C is heeded."""

    def __init__(self, machine: "LinkMachine") -> None:
        mutter(HOW_TO_STOP)
        self._machine = machine
        self._lines: queue.Queue[str] = queue.Queue()

    def has_answered(self, _key: str) -> bool:
        """Nothing: who sits here is asked."""
        return False

    def act(self, act: "Act") -> "Done":
        """Ask for it, until the person says that it is done."""
        from edmctl.board.first_start.person import Done

        words = {"": Done.DONE, "done": Done.DONE, "s": Done.SKIP, "skip": Done.SKIP}
        listed = "Enter when done, s skips"
        if act.may_be_absent:
            words |= {"a": Done.ABSENT, "absent": Done.ABSENT}
            listed += ", a: there is none"
        while (said := self._ask(f"{act.text}  [{listed}] ")) not in words:
            mutter(f"{said!r} is none of these: {listed}.\n")
        return words[said]

    def answer(self, question: "Question") -> str:
        """Ask, until the answer is one."""
        from edmctl.board.first_start.person import is_number

        options = ", ".join(question.options) or "a number"
        warning = "DANGER  " if question.danger else ""
        listed = f"{options}; s skips" + (
            "; a dangerous step takes the whole word" if question.danger else ""
        )
        while True:
            said = self._ask(f"{warning}{question.text}  [{options}; s skips] ")
            if said in ("s", "skip"):
                return ""
            full = [option for option in question.options if said and option.startswith(said)]
            if question.danger and said in question.options:
                return said
            if not question.danger and len(full) == 1:
                return full[0]
            if not question.options and is_number(said):
                return said
            mutter(f"{said!r} is none of these: {listed}.\n")

    def _ask(self, text: str) -> str:
        _forget_typed_ahead()
        mutter(text)
        threading.Thread(target=self._read, name="terminal", daemon=True).start()
        said: list[str] = []
        self._machine.wait_for(lambda: self._has_come(said))
        if not said[0]:
            raise failures.terminal_closed()
        return said[0].strip().lower()

    def _has_come(self, said: list[str]) -> bool:
        try:
            said.append(self._lines.get(timeout=_LOOK_S))
        except queue.Empty:
            return False
        return True

    def _read(self) -> None:
        self._lines.put(sys.stdin.readline())


def _forget_typed_ahead() -> None:
    """Discard what was typed before the question."""
    try:
        import termios
    except ImportError:  # not on Windows
        return
    with suppress(OSError, ValueError, termios.error):
        termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
