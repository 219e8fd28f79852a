"""`edmctl first-start`: the checklist of a newly wired machine, item by item, with a report."""

import queue
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from edmctl import failures
from edmctl.cli.options import (
    NOTES,
    ControllerOption,
    PortOption,
    SeedOption,
    SetupOption,
    WaitOption,
    command,
    option,
)
from edmctl.cli.outcome import Outcome, mutter, tell
from edmctl.cli.render.terminal import PLAIN, Ink, Style
from edmctl.cli.signals import shell
from edmctl.jsonout import render_json

if TYPE_CHECKING:
    from edmctl.board.first_start.checklist import FirstStartReport, Item, Person
    from edmctl.machine.controller import LinkMachine

AnswersOption = Annotated[
    Path | None, option("--answers FILE", "Take all answers from a TOML file; what it lacks is skipped.")
]
YesOption = Annotated[
    bool, option("--yes", "Allow every step. On a virtual machine in this process (sim:) only.")
]
OutOption = Annotated[Path, option("--out DIR", "Folder of the report.")]
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
    out: OutOption = Path("runs"),
) -> None:
    """Check the wiring of a new machine, item by item.

    Starts with everything off, names likely wiring mistakes, requests operator actions, and asks before each step
    that energises something. docs/first-start.md lists every item.
    """
    from dataclasses import replace

    from edmctl.board.first_start.run import ALL_ALLOWED, read_answers, verdict
    from edmctl.board.first_start.run import first_start as run
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
    if given is None and not yes and not sys.stdin.isatty():
        raise failures.no_terminal()
    check_folder(out)

    def person(machine: "LinkMachine") -> "Person":
        return given or (ALL_ALLOWED if yes else Terminal(machine))

    outcome.warn(seed_warning(where, seed))
    outcome.warn(controller_warning(where, controller))
    used = seed_to_use(seed)
    outcome.seed = where.seed_of(used)
    say: Callable[[str], None] = partial(tell, outcome.output)
    report, error = run(settings, where, used, person, lambda item: say(_line(item)), say, shell())
    outcome.simulated = report.simulated
    _write_report(outcome, report, out)
    if error or (error := verdict(report)):
        raise error


def _line(item: "Item") -> str:
    result = item.reason or item.read
    lines = [f"{item.status:10}{item.title}{': ' if result else ''}{result}"]
    lines += [f"{'':10}likely: {cause.text}; net {', '.join(cause.nets) or 'none'}" for cause in item.causes]
    return "\n".join(lines)


def _write_report(outcome: Outcome, report: "FirstStartReport", out: Path) -> None:
    """Write the report as text and as JSON, and set it as the result."""
    from edmctl.jobs.output_files import make_folder, write

    make_folder(out)
    stem = "first-start-" + "".join(c for c in report.started if c.isalnum())[:15]
    names = (stem if n == 1 else f"{stem}-{n}" for n in range(1, 1000))
    name = next(name for name in names if not list(out.glob(f"{name}.*")))
    text, document = out / f"{name}.txt", out / f"{name}.json"
    write(text, (render_first_start(report) + "\n").encode())
    write(document, render_json({"first_start": report}).encode())
    outcome.result = {"first_start": report, "files": [str(text), str(document)]}
    outcome.show(lambda style: render_first_start(report, style))
    outcome.text = f"Report {text}"


class Terminal:
    """A person at a terminal. While it waits, the controller hears its host, and Ctrl-C is heeded."""

    def __init__(self, machine: "LinkMachine") -> None:
        mutter(HOW_TO_STOP)
        self._machine = machine
        self._lines: queue.Queue[str] = queue.Queue()

    def has_answered(self, _key: str) -> bool:
        return False

    def ask(self, key: str) -> str:
        """Ask until the reply is one of the options, a number, or skips; a dangerous step takes the whole word."""
        from edmctl.board.first_start.checklist import PROMPTS
        from edmctl.board.first_start.run import is_number

        prompt = PROMPTS[key]
        listed = ", ".join(prompt.options).replace("done", "Enter when done") or "a number"
        listed += "; s skips"
        warning = "DANGER  " if prompt.danger else ""
        while True:
            reply = self._reply(f"{warning}{prompt.text}  [{listed}] ")
            if reply in ("s", "skip"):
                return ""
            if not reply and "done" in prompt.options:
                return "done"
            if not prompt.options and is_number(reply):
                return reply
            if reply in prompt.options:
                return reply
            matches = [option for option in prompt.options if reply and option.startswith(reply)]
            if len(matches) == 1 and not prompt.danger:
                return matches[0]
            whole = "; a dangerous step takes the whole word" if prompt.danger else ""
            mutter(f"{reply!r} is none of these: {listed}{whole}.\n")

    def _reply(self, text: str) -> str:
        """Return what is typed after the question; what was typed before it is discarded."""
        with suppress(ImportError, OSError, ValueError):  # Windows has no termios; a pipe no terminal
            import termios

            with suppress(termios.error):
                termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
        mutter(text)
        reader = threading.Thread(
            target=lambda: self._lines.put(sys.stdin.readline()), name="terminal", daemon=True
        )
        reader.start()
        replies: list[str] = []

        def has_come() -> bool:
            with suppress(queue.Empty):
                replies.append(self._lines.get(timeout=_LOOK_S))
            return bool(replies)

        self._machine.wait_for(has_come)
        if not replies[0]:
            raise failures.terminal_closed()
        return replies[0].strip().lower()


_INKS = {
    "pass": Ink.SIGNAL,
    "answered": Ink.FAINT,
    "fail": Ink.ERROR,
    "skipped": Ink.WARNING,
    "absent": Ink.FAINT,
}


def render_first_start(report: "FirstStartReport", style: Style = PLAIN) -> str:
    """Render every item under its part, and a summary."""
    lines, part = [f"First start of {report.machine}, {report.started}"], ""
    for item in report.items:
        if item.part != part:
            part = item.part
            lines += ["", style.paint(part, Ink.STRONG)]
        lines += _item(item, style)
    counts = [(status, sum(item.status == status for item in report.items)) for status in _INKS]
    lines += ["", f"{', '.join(f'{n} {status}' for status, n in counts if n)}."]
    if report.absent:
        absent = [f"{item.title} ({item.reason})" for item in report.items if item.key in report.absent]
        lines.append(f"Absent, not checked: {'; '.join(absent)}.")
    if report.ended:
        lines.append(f"Ended early: {report.ended}")
    if not report.complete:
        lines.append("Not complete: switch high voltage and amplifier off; the machine is not ready for use.")
    return "\n".join(lines)


def _item(item: "Item", style: Style) -> list[str]:
    status = style.paint(f"{item.status:8}", _INKS[item.status])
    lines = [f"{status}  {item.title}{item.reason and ': '}{item.reason}"]
    if item.read:
        rows = (("done", item.done), ("expected", item.expected), ("read", item.read))
        lines += [f"{'':10}{name:10}{text}" for name, text in rows]
    for cause in item.causes:
        nets = f"; net {', '.join(cause.nets)}" if cause.nets else ""
        lines.append(f"{'':10}{style.paint('likely    ', Ink.NOTE)}{cause.text}{nets}")
    return lines
