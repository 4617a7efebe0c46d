"""The command line `fowt`: the one place that knows FMUs, this package's components and the optimisation alike."""

from __future__ import annotations

import sys
from typing import Any

import typer
from typer.core import TyperGroup

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
from cosim.cli.console import Interrupted, emit_error, failure, warn


class Commands(TyperGroup):
    """The commands; one that is stopped by the user in a place where nothing is to be kept says so as well."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that a context asks for."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Interrupted("stopped by the user") from None


app = typer.Typer(
    cls=Commands,
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
    """Entry point: one line and a non-zero exit code for anything a user can put right.

    With --format json, the line is also on stdout as {"error": "..."}.
    """
    try:
        sys.exit(app(standalone_mode=False))
    except Interrupted as error:
        emit_error(str(error))
        warn(str(error))
        sys.exit(130)
    except (ValueError, RuntimeError, OSError) as error:
        text = str(error) or type(error).__name__
        emit_error(text)
        failure(text)
        sys.exit(1)
    except Exception as error:
        if not hasattr(error, "format_message"):  # of a mistake in the command's words
            emit_error(f"{type(error).__name__}: {error}")
            raise
        if text := error.format_message():  # else the help was asked for, and shown
            emit_error(text)
            failure(f"{text} (see 'fowt --help' or 'fowt COMMAND --help')")
        sys.exit(2)
