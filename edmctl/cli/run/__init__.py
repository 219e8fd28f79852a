"""`edmctl run`: look at run files."""

from edmctl.cli.options import command_group
from edmctl.cli.run import export, plot, show
from edmctl.report.kinds import kinds_table

app = command_group("Show, compare, export, draw and recover run files.")
app.command("list")(show.list_runs)
app.command("show")(show.show)
app.command("explain")(show.explain)
app.command("export")(export.export)
app.command("recover")(show.recover)
app.command("plot", epilog="\b\nKinds of figures:\n" + kinds_table())(plot.plot)
app.command("compare")(show.compare)
