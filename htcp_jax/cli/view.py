"""`htcp view`: plans in the browser."""

import contextlib
import importlib.util
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import Overrides, stdout
from htcp_jax.cli.plan import plan_with_progress
from htcp_jax.errors import InputError
from htcp_jax.viewer.replay import Replays, open_replays, replays_of

What = Annotated[
    Path | None,
    typer.Argument(metavar="RUN|CONFIG.yaml", help="A folder of htcp sweep or htcp plan, or a job; else the default."),
]
Scenario = Annotated[int | None, typer.Option(metavar="K", help="The first shown; by default one that failed.")]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="The first shown; of a job, the one that plans.", autocompletion=complete_method),
]
Host = Annotated[str, typer.Option(metavar="ADDRESS", help="To listen on; 0.0.0.0 lets other machines look.")]
Port = Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="To listen on; 0 takes any that is free.")]


def view(
    what: What = None,
    scenario: Scenario = None,
    method: Method = None,
    overrides: Overrides = None,
    host: Host = "127.0.0.1",
    port: Port = 8080,
) -> int:
    """Look at plans in the browser: the arm with its capsules, the workpiece cut open, the targets, the clearance.

    A run folder is shown as it is, failed scenarios first; a job is planned first. Only this machine can connect,
    unless --host says otherwise. Needs the extra "view". Ctrl-C ends it; exits with 2 on bad input.

    \b
    htcp view                                    the default job
    htcp view out/workpiece --method nspace-sqp  a sweep
    htcp view job.yaml --set margin_m=0.001 --port 8081
    """
    if importlib.util.find_spec("viser") is None:
        raise InputError("htcp view needs viser: pip install 'htcp_jax[view]'")
    with contextlib.suppress(KeyboardInterrupt):  # before the page is up as well as after
        replays = _replays(what, method, overrides or [])
        from htcp_jax.viewer.browser import Viewer  # viser is an extra

        viewer = Viewer(replays, host, port, scenario, method)
        try:
            stdout().print(Text.assemble(("viewer  ", "cyan"), viewer.address, ("  (Ctrl-C ends it)", "dim")))
            viewer.wait()
        finally:
            viewer.stop()
    return 0


def _replays(what: Path | None, method: str | None, overrides: list[str]) -> Replays:
    """What there is to look at; a job is planned."""
    if what is not None and not what.exists():
        raise InputError(f"{what}: no such run folder, and no such job")
    if what is not None and what.is_dir():
        if overrides:
            raise InputError("--set changes a job; a run folder is shown as it is")
        return open_replays(what)
    return replays_of(str(what or "the default job"), plan_with_progress(what, overrides, method))
