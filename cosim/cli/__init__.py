"""The command line `fowt`: the one place that knows FMUs, this package's components and the optimisation alike."""

from __future__ import annotations

import sys

import typer

from cosim.cli import (
    build,
    campaign,
    compare,
    converge,
    convert,
    identify,
    inspect,
    linearise,
    listing,
    methods,
    optimise,
    package,
    report,
    reproduce,
    run,
    sensitivity,
    verify,
)
from cosim.cli.console import failure

app = typer.Typer(
    name="fowt",
    help="Design tuned mass dampers for floating wind turbines by co-simulating FMUs.",
    epilog="Start with: fowt compare lc4",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
app.command("build")(build.build)
app.command("run")(run.run)
app.command("export")(package.export)
app.command("compare")(compare.compare)
app.command("convert")(convert.convert)
app.command("campaign")(campaign.campaign)
app.command("converge")(converge.converge)
app.command("identify")(identify.identify)
app.command("optimise")(optimise.optimise)
app.command("linearise")(linearise.linearise)
app.command("map")(sensitivity.fitness_map)
app.command("report")(report.report)
app.command("methods")(methods.methods)
app.command("reproduce")(reproduce.reproduce)
app.command("verify")(verify.verify)
app.command("inspect")(inspect.inspect)
app.command("validate")(inspect.validate)
app.command("list")(listing.list_all)


def main() -> None:
    """Entry point: one line and a non-zero exit code for anything a user can put right."""
    try:
        sys.exit(app(standalone_mode=False))
    except (ValueError, RuntimeError, OSError) as error:
        failure(str(error) or type(error).__name__)
        sys.exit(1)
    except Exception as error:
        if not hasattr(error, "format_message"):  # of a mistake in the command's words
            raise
        if error.format_message():  # else the help was asked for, and shown
            failure(f"{error.format_message()} (see 'fowt --help' or 'fowt COMMAND --help')")
        sys.exit(2)
