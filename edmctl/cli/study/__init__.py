"""`edmctl study`: designed experiments, on virtual machines and on the real one."""

import typer

from edmctl.cli.study import analyse, execute, look, record

app = typer.Typer(
    help="Plan, run and analyse designed experiments.", rich_markup_mode=None, add_completion=False
)


@app.callback()
def study() -> None:
    """Plan, run and analyse designed experiments.

    A study file names factors, a design and responses; a folder holds the plan and a row of every run.
    """


app.command("list")(look.list_studies)
app.command("plan")(look.plan)
app.command("run")(execute.run)
app.command("resume")(execute.resume)
app.command("status")(look.status)
app.command("tell")(record.tell)
app.command("import")(record.import_table)
app.command("judge")(record.judge)
app.command("report")(analyse.report)
app.command("suggest")(execute.suggest)
app.command("optimize")(execute.optimize)
app.command("confirm")(execute.confirm)
app.command("export")(analyse.export)
