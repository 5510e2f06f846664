"""`htcp example`: list the shipped jobs, sweeps and placement searches, or copy one to a folder."""

import os
import shlex
import shutil
from pathlib import Path
from typing import Annotated

import typer

from htcp_jax.cli.output import Json, print_facts, print_json, print_table, stdout
from htcp_jax.errors import InputError
from htcp_jax.report import Table
from htcp_jax.runs import columns
from htcp_jax.spec import examples
from htcp_jax.system import output_files


def complete_example(start: str) -> list[str]:
    """Return the names of examples that begin with `start`, for shell completion."""
    return [name for name in examples.examples() if name.startswith(start)]


Name = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME", help="Example to copy; without it, all examples are listed.", autocompletion=complete_example
    ),
]
Folder = Annotated[Path | None, typer.Argument(metavar="DIR", help="New or empty output folder.")]


def example(name: Name = None, folder: Folder = None, as_json: Json = False) -> int:
    """List the example jobs, sweeps and placement searches, or copy one with its files to a folder.

    Every command that reads such a file also accepts the name of an example.

    Exit codes: 0, 2 if the name is unknown or DIR is not empty.

    \b
    Examples:
      htcp example                              the list
      htcp example pipe my-job                  copy one example as a start for your own job
      htcp plan my-job/job.yaml --set settings.seed=1
      htcp plan pipe                            the example itself
    """
    known = examples.examples()
    if name is None:
        rows = tuple((each, examples.command(each), examples.description(file)) for each, file in known.items())
        table = Table("examples", columns.of("name", "command", "description"), rows)
        print_json(table.records()) if as_json else print_table(stdout(), table)
        return 0
    if name not in known:
        raise InputError(f"unknown example {name!r}; valid: {', '.join(known)}")
    if folder is None:
        raise InputError(f"the output folder is missing: pass htcp example {name} DIR")
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty; name a new or an empty folder")
    files = sorted(examples.files_with_baseline(known[name]))
    root = os.path.commonpath([file.parent for file in files])
    with output_files.written_whole(folder) as scratch:
        for file in files:
            copy = scratch / file.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
    written = [str(folder / file.relative_to(root)) for file in files]
    main = str(folder / known[name].relative_to(root))
    if as_json:
        print_json({"example": name, "file": main, "files": written})
    else:
        print_facts(name, {"files": ", ".join(written), "run it by": f"{examples.command(name)} {shlex.quote(main)}"})
    return 0
