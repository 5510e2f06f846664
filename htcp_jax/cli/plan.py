"""`htcp plan`: plan one job, print a table and write five files."""

import contextlib
import gc
import hashlib
import importlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import (
    Device,
    Json,
    Overrides,
    Seed,
    claim_device,
    print_facts,
    print_json,
    progress_bar,
    progress_text,
    stdout,
)
from htcp_jax.errors import Interrupted
from htcp_jax.jobs import load_config, seeded, source_of
from htcp_jax.planning import registry
from htcp_jax.spec import PlanConfig
from htcp_jax.system import INTERRUPTED, is_watched, stop_message

if TYPE_CHECKING:
    from htcp_jax.api import Plan
    from htcp_jax.planning import Progress

COMPLETE, INCOMPLETE = 0, 3
LONG_S = 3.0  # time without a further target after which the progress names the target that is searched
MATPLOTLIB = "matplotlib.figure", "matplotlib.backends.backend_agg"


Config = Annotated[
    Path | None, typer.Argument(metavar="CONFIG.yaml", help="Job file or example; by default the default job.")
]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Planning method; htcp methods lists them.", autocompletion=complete_method),
]
Retract = Annotated[
    bool, typer.Option("--retract", help="Append the return motion, to home or the start, to motion.csv.")
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print more rows: smoothness, joint paths, clearance.")]


def plan(
    config: Config = None,
    method: Method = None,
    overrides: Overrides = None,
    out: Out = Path("out/plan"),
    seed: Seed = None,
    retract: Retract = False,
    device: Device = None,
    verbose: Verbose = False,
    as_json: Json = False,
) -> int:
    """Plan one job: a collision-free motion that moves the tool along the path.

    Writes motion.csv (the configurations to execute), trajectory.csv and trajectory.npz (one row per target),
    summary.json and plan.png.

    Exit codes: 0 if a proven motion leads to the last target, 3 if not (the tracked targets are saved), 2 on bad input,
    130 or 143 after a signal.

    The value of a key comes from --set, else from the job file, else from the file named by the job's key config, else
    from the defaults for the arm and part. By default your own part is at the world's origin, not rotated.

    \b
    Examples:
      htcp plan                                 the default job, the generated duct
      htcp plan pipe                            an example; htcp example lists them
      htcp plan cone --method hybrid            an example by another method
      htcp plan --set settings.alpha_rad=0.05 --set "start_rad=[0, -2.3, 0.5, 0, 0.5, 0]"
    """
    changes = [*seeded(overrides or (), seed), *([] if method is None else [f"method={method}"])]
    job = job_of(config, changes, None)
    claim_device(device)
    load_matplotlib()
    with _programs_preloaded(job, device):
        from htcp_jax import api  # imported here, as it imports JAX
        from htcp_jax.runs import plan_folder
        from htcp_jax.system import output_files

        plan_folder.refuse_run(out)
        with output_files.written_whole(out) as folder:
            made = plan_with_progress(job, config, changes, device)
            with progress_text("writing results"):
                made.write(folder, retract=retract)
                facts = made.facts(verbose=verbose)
    api.forget_validation(out)
    if as_json:
        print_json(made.record())
    else:
        print_facts(str(made), facts | {"files": str(out)})
        for where, why in made.failure().items():
            stdout().print(Text.assemble((f"{where}: ", "red"), why))
    return COMPLETE if made.complete else INCOMPLETE


@contextlib.contextmanager
def _programs_preloaded(job: PlanConfig, device: str | None) -> Iterator[None]:
    """Return a context in whose beginning threads load the programs that the last plan of such a job used.

    This is done only in the command's own process, as programs that are not called are not freed.
    """
    from htcp_jax.caching import cache_folder
    from htcp_jax.device import devices, kept_executables

    if not is_watched() or cache_folder.enable() is None:
        yield
        return
    alike = repr((job.method, job.robot, job.cell, job.task))
    name = hashlib.blake2b(alike.encode(), digest_size=8).hexdigest()
    kept_executables.preload(name, devices.choose(device)[0])
    yield
    kept_executables.remember(name)


def load_matplotlib() -> threading.Thread:
    """Start a thread that imports matplotlib, as compiled code releases the interpreter's lock.

    Until it ends, Python collects no garbage. A collection calls JAX, where the thread may lose its turn, and Python
    3.11 counts the nesting of code that it parses for all threads together: if both threads were parsing, as imports of
    lazy_loader and matplotlib do, one of them failed with a SystemError.
    """

    def load() -> None:
        try:
            for module in MATPLOTLIB:
                importlib.import_module(module)
        finally:
            gc.enable()

    gc.disable()
    thread = threading.Thread(target=load, daemon=True)
    thread.start()
    return thread


def job_of(config: Path | None, overrides: Sequence[str], method: str | None) -> PlanConfig:
    """Load a job. JAX is imported only if an obstacle or task row of another package requires it.

    Args:
        config: The job file or example; None: the default job.
        overrides: Changes to the job, each "dotted.key=value".
        method: Name of the planning method; None: the job's.

    Raises:
        InputError: If the job is invalid or the method is unknown.
    """
    job = load_config(config, [*overrides, *([] if method is None else [f"method={method}"])])
    registry.METHODS.refuse_unknown(job.method)
    return job


def plan_with_progress(
    job: PlanConfig, config: Path | None, changes: Sequence[str] = (), device: str | None = None
) -> "Plan":
    """Plan a job, and show the number of tracked targets in a progress bar.

    Args:
        job: The job.
        config: The job's file or example, for messages; None: the default job.
        changes: The changes to it, for messages.
        device: Name of the device; None: a GPU if there is one.

    Raises:
        InputError: See `api.plan`.
        Interrupted: On Ctrl-C.
    """
    from htcp_jax import api
    from htcp_jax.caching import cache_folder
    from htcp_jax.runs import failure_texts

    cache_folder.enable()
    with progress_bar("", first="loading and compiling; targets") as progress:
        search = _Search(progress, job.method == "beam" and job.settings.effort > 0)
        with stop_message(lambda: search.stop_text):
            try:
                known = {"source": source_of(config), "arguments": failure_texts.arguments(config, changes)}
                return api.plan_job(job, **known, device=device, progress=search.update)
            except KeyboardInterrupt:
                raise Interrupted(search.stop_text, signal.SIGINT) from None


class _Search:
    """Progress of one plan, and whether it is searching for a motion to the next target for long."""

    def __init__(self, progress: Callable[..., None], recovers: bool):
        self._progress, self._recovers, self._tracked, self._since_s, self._text = progress, recovers, -1, 0.0, ""
        self._phase = ""

    @property
    def stop_text(self) -> str:
        """The message after a signal: during a long search after a dead end, also how to keep the targets before it."""
        if self._phase:
            return f"stopped{self._phase}; nothing is saved before the motion through all seams is proven"
        if not self._text or not self._recovers:
            return INTERRUPTED
        kept = "with --set settings.effort=0 a plan ends at its first dead end and is saved"
        return f"stopped{self._text}; nothing is saved; {kept}"

    def update(self, now: "Progress") -> None:
        """Show the number of tracked targets and, after LONG_S without a further one, the target that is searched."""
        if now.targets_tracked != self._tracked:
            self._tracked, self._since_s = now.targets_tracked, time.monotonic()
        is_long = not now.phase and self._tracked < now.targets and time.monotonic() - self._since_s >= LONG_S
        self._text = f"; searching for a motion to target {self._tracked}" if is_long and now.starts != 0 else ""
        self._phase = now.phase and f"; {now.targets_tracked} of {now.targets} {now.unit}{now.phase}"
        drawn, most = now.draws
        phase = f"; looking for a start: {drawn:,} of {most:,} configurations" if now.starts == 0 else ""
        self._progress(self._tracked, now.targets, now.unit + phase + self._text + now.phase)
