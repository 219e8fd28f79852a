"""`edmctl study`: designed experiments, on virtual machines and on the real one."""

from edmctl.cli.options import command_group
from edmctl.study.commands import execute, look

app = command_group(
    "Plan, run and analyse designed experiments.\n\n"
    "A study file names factors, a design and responses. A folder contains the plan and a row of each run."
)
app.command("list")(look.list_studies)
app.command("plan")(look.plan)
app.command("run")(execute.run)
app.command("resume")(execute.resume)
app.command("status")(look.status)
app.command("tell")(look.tell)
app.command("import")(look.import_table)
app.command("judge")(look.judge)
app.command("report")(look.report)
app.command("suggest")(execute.suggest)
app.command("extend")(execute.extend)
app.command("optimize")(execute.optimize)
app.command("confirm")(execute.confirm)
app.command("export")(look.export)
