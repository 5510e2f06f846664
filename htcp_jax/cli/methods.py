"""`htcp methods`: list the planning methods with their descriptions."""

from typing import Annotated

import typer

from htcp_jax.cli.output import Json, print_json, print_table, stdout
from htcp_jax.planning import registry
from htcp_jax.report import Table
from htcp_jax.runs import columns


def methods(as_json: Json = False) -> int:
    """List the planning methods, including those of installed plugins, by their names for --method and --methods.

    Exit code: 0.

    \b
    Examples:
      htcp methods                              the table
      htcp methods --json                       for another program
    """
    rows = tuple((name, *words) for name, words in registry.descriptions().items())
    table = Table("methods", columns.of("method", "title", "description"), rows)
    if as_json:
        print_json(table.records())
    else:
        print_table(stdout(), table)
    return 0


def complete_method(start: str) -> list[str]:
    """Return the method names that begin with `start`, for shell completion."""
    return [name for name in registry.names() if name.startswith(start)]


def complete_methods(start: str) -> list[str]:
    """Return shell completions for a comma-separated list of method names; only its last name is completed."""
    before, comma, last = start.rpartition(",")
    given = before.split(",")
    return [before + comma + name for name in complete_method(last) if name not in given]


RunMethod = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Planning method; by default the run's first.", autocompletion=complete_method),
]
