"""`edmctl study`: designed experiments. Here are the commands that make no runs."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from edmctl import failures
from edmctl.cli.options import NOTES, argument, command, command_group, option
from edmctl.cli.outcome import Outcome, stdout_sink
from edmctl.cli.render.terminal import (
    PLAIN,
    USUAL_COLUMNS,
    Ink,
    Style,
    labelled,
    narrowed,
    not_shown,
    render_columns,
    render_table,
    wrapped,
)
from edmctl.cli.signals import shell
from edmctl.dataclasses import asdict, replace
from edmctl.profile.folders import shipped_studies
from edmctl.study.commands import execute
from edmctl.study.commands.execute import (
    FolderArgument,
    RunNumberArgument,
    StudyArgument,
    opened,
    study_source,
)
from edmctl.study.results import Judgement, PlannedRun, RunKind, RunState, StudyPlan, StudyRun
from edmctl.wording import duration, length, plural, setting_text, significant

MOST_RUNS_SHOWN = 60
LABEL_CELLS = 14


@command("study list")
def list_studies(outcome: Outcome) -> None:
    """List the shipped studies."""
    from edmctl.study.study_file import read_study

    studies = []
    for name, path in shipped_studies().items():
        file = read_study(path).file
        texts = {"name": file.study.name, "description": file.study.description}
        studies.append({"study": name, **texts, "design": file.design.kind})
    outcome.result = {"studies": studies}
    rows = [[one["study"], one["design"], one["description"] or one["name"]] for one in studies]
    outcome.show(lambda style: render_columns(["study", "design", "question"], rows, style, "<"))


@command("study plan", NOTES)
def plan(outcome: Outcome, file: StudyArgument) -> None:
    """Check a study and show its runs, their costs, and the effects that they can show.

    Every run is checked as a job is; nothing moves and nothing is written.
    """
    from edmctl.study.planning import plan_study

    planned = plan_study(study_source(outcome, file), shell())
    outcome.warn(planned.warnings)
    outcome.result = asdict(planned.plan)
    outcome.show(lambda style: render_plan(planned.plan, style))
    outcome.text = f"\nRun it: `edmctl study run {shlex.quote(file)} --out DIR`"


@command("study status")
def status(outcome: Outcome, folder: FolderArgument) -> None:
    """Show every run of a study with its responses, and what the study waits for."""
    from edmctl.study.folder import version_warning
    from edmctl.study.table import counts_of, in_words, missing_manual, table_of, what_next

    study = opened(folder)
    outcome.warn(version_warning(study))
    state = study.read()
    outcome.result = {
        "study": study.plan.name,
        "runs": len(state.runs),
        "counts": counts_of(state.runs),
        "missing": [{"run": number, "responses": list(names)} for number, names in missing_manual(state)],
        "torn_lines": state.rows.torn,
        "table": table_of(state),
    }
    words, steps = in_words(state.runs), what_next(state)
    outcome.show(lambda style: render_status(study.plan, state.runs, words, steps, style))


PageOption = Annotated[
    Path | None, option("--out -o PAGE", "HTML page with all tables and figures. Default: none.")
]
TableOption = Annotated[Path | None, option("--out -o TABLE.csv", "CSV file. Default: stdout.")]
OverwriteOption = Annotated[bool, option("--overwrite", "Replace files of the same name.")]
ValuesArgument = Annotated[
    list[str], argument("NAME=VALUE...", "Manual responses of the run, e.g. ra_um=0.31.")
]
TableArgument = Annotated[Path, argument("TABLE.csv", "A column run, and one for each manual response.")]
JudgementArgument = Annotated[Judgement, argument("accept|reject|repeat", "Which it is.")]
ReasonArgument = Annotated[str, argument("REASON", "Kept with the run.")]


@command("study report")
def report(
    outcome: Outcome, folder: FolderArgument, out: PageOption = None, overwrite: OverwriteOption = False
) -> None:
    """Show which factors matter, by analysis of variance, models and the Pareto front; --out writes a page."""
    from edmctl.jobs import output_files
    from edmctl.study.report import mapping_of, render_report, report_of
    from edmctl.study.report.page import render_study_page

    found = report_of(opened(folder).read(), shell())
    outcome.result = mapping_of(found)
    outcome.show(lambda style: render_report(found, style))
    if out is not None:
        content = render_study_page(found, source=str(folder)).encode()
        output_files.make_folder(out.parent)
        hint = "Choose another name, or replace it with --overwrite."
        output_files.write(out, content, hint, overwrite=overwrite)
        outcome.text = f"\nPage {out}"


@command("study export")
def export(
    outcome: Outcome,
    folder: FolderArgument,
    out: TableOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write the table of runs as CSV: a column a factor key and response."""
    from edmctl.csv_text import table_text
    from edmctl.jobs import output_files
    from edmctl.jobs.runs.outputs import REPLACE_TABLE_HINT
    from edmctl.study.table import table_of

    state = opened(folder).read()
    content = table_text(table_of(state)).encode()
    if out is None:
        if outcome.output.json:
            raise failures.stdout_taken_by_json()
        with stdout_sink() as sink:
            sink.write(content)
        return
    if out.suffix.lower() != ".csv":
        raise failures.study_table_not_csv(out=out.name)
    output_files.write(out, content, REPLACE_TABLE_HINT, overwrite=overwrite)
    outcome.result = {"file": str(out), "rows": len(state.runs), "bytes": len(content)}
    outcome.text = f"{out}: {plural(len(state.runs), 'row')}"


@command("study tell")
def tell(outcome: Outcome, folder: FolderArgument, run: RunNumberArgument, values: ValuesArgument) -> None:
    """Report responses that were measured by hand, such as a roughness from a profilometer.

    A later value replaces an earlier one, and `NAME=none` withdraws it; all of them stay in the rows.
    """
    from edmctl.study.table import made_run, reported_values

    study = opened(folder)
    state = study.read()
    target, reported = made_run(state, run), reported_values(state, values)
    with study.writer() as writer:
        writer.told(target, reported)
    outcome.result = {"run": run, "told": reported}
    texts = (f"{name} {'is withdrawn' if v is None else f'= {v:g}'}" for name, v in reported.items())
    outcome.text = f"Run {run}: {', '.join(texts)}"


@command("study import")
def import_table(outcome: Outcome, folder: FolderArgument, table: TableArgument) -> None:
    """Report the manual responses of many runs by a CSV table: all of it or, if a line is wrong, nothing.

    Empty cells are skipped, and `none` withdraws a reported value.
    """
    from edmctl.study.table import reported_table

    study = opened(folder)
    state = study.read()
    reported = reported_table(state, table)
    with study.writer() as writer:
        for number, values in reported.items():
            writer.told(state.run(number), values)
    outcome.result = {"runs": len(reported), "told": {str(number): one for number, one in reported.items()}}
    outcome.text = f"Reported responses of {plural(len(reported), 'run')}."
    if withdrawn := [str(number) for number, values in reported.items() if None in values.values()]:
        outcome.text += f" Withdrawn: of {plural(len(withdrawn), 'run')}, {', '.join(withdrawn)}."


@command("study judge")
def judge(
    outcome: Outcome,
    folder: FolderArgument,
    run: RunNumberArgument,
    judgement: JudgementArgument,
    reason: ReasonArgument,
) -> None:
    """Judge a run: accept one that failed, reject one that shall not count, or have it repeated.

    Nothing is deleted: the row stays, with the judgement and its reason.
    """
    from edmctl.study.on_machine import is_begun, next_order
    from edmctl.study.running import lost_row

    study = opened(folder)
    if not reason.strip():
        raise failures.judgement_without_reason()
    target = study.read().run(run)
    if target.row is None and judgement is Judgement.REPEAT and is_begun(study, target):
        with study.claimed(), study.writer() as writer:  # no other command is making it
            # The hole stays where it is, and the next attempt takes another place.
            lost = lost_row(target.planned, target.attempts + 1, f"E1300: abandoned: {reason}", 130)
            writer.run(replace(lost, order=next_order(study.read())))
        target = study.read().run(run)
    if target.row is None and judgement is not Judgement.REJECT:
        raise failures.judged_run_not_made(run=run, study=study.read().making_command())
    with study.writer() as writer:
        writer.judged(target, judgement, reason)
    outcome.result = {"run": run, "attempt": target.attempts, "judgement": str(judgement), "reason": reason}
    state = study.read()
    again = "as another hole at the next free place" if state.rows.port else "with the same result"
    effect = {
        Judgement.ACCEPT: "its responses count",
        Judgement.REJECT: "it does not count; the row stays",
        Judgement.REPEAT: f"`{state.making_command()}` makes it again, {again}",
    }
    outcome.text = f"Run {run}: {judgement} ({reason}); {effect[judgement]}."


def render_plan(plan: StudyPlan, style: Style = PLAIN) -> str:
    """Render what will be run: design, factors, model, costs, and every run in its order."""
    columns = style.columns or USUAL_COLUMNS
    lines = [style.paint(f"{plan.name}: {plan.kind}", Ink.STRONG)]
    if plan.description:
        lines += wrapped(plan.description, columns)
    dof = ", ".join(f"{name} {count}" for name, count in plan.dof.items())
    facts = {
        "runs": _counts(plan),
        "responses": ", ".join(one.label + (" (by hand)" if one.is_manual else "") for one in plan.responses),
        "constraints": ", ".join(map(str, plan.constraints)),
        "objectives": ", ".join(
            f"{name} (weight {weight:g})" if weight != 1 else name for name, weight in plan.objectives
        ),
        "model": f"{plan.model}; degrees of freedom: {dof}",
        "takes": _costs(plan),
        "aliases": "; ".join(plan.aliases),
    }
    lines += [labelled(name, text, LABEL_CELLS, columns) for name, text in facts.items() if text]
    factors = [
        [one.name, one.key, (" to " if one.is_range else ", ").join(map(setting_text, one.values))]
        for one in plan.factors
    ]
    parts = ["\n".join(lines), render_columns(["factor", "key", "values"], factors, style, "<", "values")]
    shared = "tool" if any(run.tool for run in plan.runs) else "seed"
    is_shown = shared == "tool" or len({run.seed for run in plan.runs}) > 1
    head = ["run", "point", *([shared] if is_shown else []), *(factor.name for factor in plan.factors)]
    rows = []
    for run in plan.runs[:MOST_RUNS_SHOWN]:
        row = [str(run.number), _point(run), *([str(getattr(run, shared))] if is_shown else [])]
        rows.append([*row, *(setting_text(run.settings[factor.key]) for factor in plan.factors)])
    if len(plan.runs) > MOST_RUNS_SHOWN:
        rows.append(["…", f"and {len(plan.runs) - MOST_RUNS_SHOWN} more"])
    parts.append(render_columns(head, rows, style, "<<>"))
    if plan.notes:
        parts.append(
            "\n".join(line for note in plan.notes for line in wrapped(f"note: {note}", columns, "  "))
        )
    return "\n\n".join(parts)


def _counts(plan: StudyPlan) -> str:
    parts = [f"{plural(len(plan.runs), 'run')} of {plural(plan.points, 'point')}"]
    blocks = len({run.block for run in plan.runs})
    tools = len({run.tool for run in plan.runs} - {0})
    if plan.replicates > 1:
        parts.append(f"{plan.replicates} replicates")
    if blocks > 1 and tools != blocks:
        parts.append(f"{blocks} blocks")
    first, last = min(run.seed for run in plan.runs), max(run.seed for run in plan.runs)
    seeds = f"seed {first}" if first == last else f"seeds {first} to {last}"
    return ", ".join([*parts, plural(tools, "tool") if tools else seeds])


def _costs(plan: StudyPlan) -> str:
    if plan.costs is None:
        return ""
    text = f"{duration(plan.costs.time_s)} of the machine, {duration(plan.costs.machining_time_s)} of it machining"
    if plan.costs.tool_wear_um:
        worn = ", ".join(map(length, plan.costs.tool_wear_um))
        text += f"; tools lose {worn} of {length(plan.costs.most_wear_um)}"
    if plan.costs.places:
        text += f"; {len(plan.runs)} of {plural(plan.costs.places, 'place')} of the grid"
    return text


def render_status(
    plan: StudyPlan, runs: Sequence[StudyRun], words: str, steps: Sequence[str], style: Style = PLAIN
) -> str:
    """Render every run with its state and responses, and the next steps."""
    columns = style.columns or USUAL_COLUMNS
    some = runs[:MOST_RUNS_SHOWN]
    table: dict[str, list[str]] = {
        "run": [str(run.planned.number) for run in some],
        "state": [
            f"{run.state}, attempt {run.row.attempt}" if run.row and run.row.attempt > 1 else str(run.state)
            for run in some
        ],
        "point": [_point(run.planned) for run in some],
    }
    for factor in plan.factors:
        table[factor.name] = [setting_text(run.planned.settings[factor.key]) for run in some]
    if any(run.row is not None or run.told for run in runs):
        for response in plan.responses:
            table[response.label] = [_cell(run, response.name) for run in some]
    fitted = narrowed(table, style.columns, [*(f.name for f in reversed(plan.factors)), "point"])
    lines = [*wrapped(f"{plan.name}: {words}.", columns), "", render_table(fitted, style, left=("state",))]
    if len(runs) > len(some):
        lines.append(f"… and {len(runs) - len(some)} more runs: `edmctl study export` has all of them")
    failed = [run for run in runs if run.state is RunState.FAILED and run.row is not None]
    errors = [f"run {run.planned.number}: {run.row.error}" for run in failed[:10] if run.row is not None]
    notes = [note for note in (not_shown(table, fitted), *steps, *errors) if note]
    return "\n".join([*lines, "", *(line for note in notes for line in wrapped(note, columns, "  "))])


def _point(run: PlannedRun) -> str:
    return str(run.point) if run.kind is RunKind.DESIGN else f"{run.point} {run.kind}"


def _cell(run: StudyRun, name: str) -> str:
    value, u95 = run.value(name), run.u95(name)
    if value is None:
        return "–"
    return significant(value, 4) + (f" ± {significant(u95, 2)}" if u95 else "")


app = command_group(
    "Plan, run and analyse designed experiments.\n\n"
    "A study file names factors, a design and responses. A folder contains the plan and a row of each run."
)
app.command("list")(list_studies)
app.command("plan")(plan)
app.command("run")(execute.run)
app.command("resume")(execute.resume)
app.command("status")(status)
app.command("tell")(tell)
app.command("import")(import_table)
app.command("judge")(judge)
app.command("report")(report)
app.command("suggest")(execute.suggest)
app.command("extend")(execute.extend)
app.command("optimize")(execute.optimize)
app.command("confirm")(execute.confirm)
app.command("export")(export)
