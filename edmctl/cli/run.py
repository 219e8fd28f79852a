"""`edmctl run`: look at run files."""

import typer

from edmctl.cli import run_compare, run_explain, run_export, run_list, run_plot, run_recover, run_show
from edmctl.report.kinds import kinds_table

app = typer.Typer(help="Look at run files.", rich_markup_mode=None, add_completion=False)


@app.callback()
def run() -> None:
    """Look at run files."""


app.command("list")(run_list.list_runs)
app.command("show")(run_show.show)
app.command("explain")(run_explain.explain)
app.command("export")(run_export.export)
app.command("recover")(run_recover.recover)
app.command("plot", epilog="\b\nKinds of figures:\n" + kinds_table())(run_plot.plot)
app.command("compare")(run_compare.compare)
