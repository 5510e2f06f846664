"""`htcp view`: show plans in the browser."""

import importlib.util
import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from htcp_jax.cli.feed import OneWay, PlayedFeed, played_feed
from htcp_jax.cli.heartbeat import HEARTBEAT
from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.motion_options import Format, Interpolation, Joints, Unit, joint_names
from htcp_jax.cli.output import Overrides, Seed, progress_bar, progress_text, stdout
from htcp_jax.cli.plan import job_of, plan_with_progress
from htcp_jax.errors import InputError, Interrupted, install_command
from htcp_jax.jobs import seeded
from htcp_jax.runs import open_plans
from htcp_jax.spec import examples
from htcp_jax.system import stop_message
from htcp_jax.trajectory import PlanProgram, program_of, program_of_plans
from htcp_jax.viewer import Replays, recorded_replays, replays_of

CLOSED = "closed"
What = Annotated[
    Path | None,
    typer.Argument(
        metavar="RUN|CONFIG.yaml|FILE",
        help="Output folder of htcp plan or htcp sweep, or a job to plan; by default the default job. With --job, a "
        "trajectory or robot program.",
    ),
]
Scenario = Annotated[int | None, typer.Option(metavar="K", help="Scenario shown first; by default one that failed.")]
Method = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Method shown first; for a job, the planning method.", autocompletion=complete_method
    ),
]
Job = Annotated[
    Path | None, typer.Option(metavar="JOB.yaml", help="Play a file in the cell of this job, as htcp prove reads it.")
]
Host = Annotated[
    str, typer.Option(metavar="ADDRESS", help="Address to listen on; 0.0.0.0 lets other machines connect.")
]
Port = Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Port to listen on; 0 selects a free one.")]


def view(
    what: What = None,
    job: Job = None,
    scenario: Scenario = None,
    method: Method = None,
    overrides: Overrides = None,
    seed: Seed = None,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    feed: PlayedFeed = None,
    one_way: OneWay = False,
    format: Format = None,
    unit: Unit = None,
    joints: Joints = None,
    interpolation: Interpolation = None,
) -> int:
    """Show plans in the browser: the arm with its capsules, the workpiece, targets, clearance.

    Failed scenarios of a run are listed first. A job is planned before it is shown. With --feed, the timed motion
    of htcp program is played in real time, with TCP and joint speeds; --set then changes keys of the job's section
    program. With --job, the motion of a file is proven as by htcp prove, with its options --format, --unit, --joints
    and --interpolation, and played. The space bar plays and pauses, the left and right arrow keys step. Only this
    machine can connect; pass --host 0.0.0.0 to let other machines connect, with the token in the printed address.
    Install the extra "view". Writes no files.

    Exit codes: 130 after Ctrl-C, 2 on bad input.

    \b
    Examples:
      htcp view                                    the default job
      htcp view pipe --seed 1 --port 8081
      htcp plan
      htcp view out/plan --feed 20mm/s             a timed motion, in real time
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
      htcp view out/workpiece --method nspace-sqp  a sweep
      htcp view out/plan/motion.csv --job duct     a trajectory or robot program
    """
    if importlib.util.find_spec("viser") is None:
        raise InputError(f"htcp view needs viser: {install_command('view')}")
    feed_m_s = played_feed(feed, one_way=one_way)
    text, how = "", {"format": format, "unit": unit, "joints": joints, "interpolation": interpolation}
    if job is not None:
        if what is None or feed_m_s or method is not None or scenario is not None:
            raise InputError("--job plays a FILE; --feed, --method and --scenario do not apply to it")
        how |= {"joints": joint_names(joints)}
        (replays, text), programs = _replays_of_file(what, job, seeded(overrides or (), seed), how), None
    elif given := [name for name, value in how.items() if value is not None]:
        raise InputError(f"--{given[0]} is an option of files; pass --job, too")
    else:
        replays, programs = _replays_and_programs(what, method, seeded(overrides or (), seed), feed_m_s, not one_way)
    from htcp_jax.viewer import Viewer  # here, as viser is an optional dependency

    with progress_text("drawing the scene" if feed_m_s is None else "timing the motion and drawing the scene"):
        viewer = Viewer(replays, host, port, scenario, method, programs if feed_m_s else None)
    HEARTBEAT.end()  # from now on the viewer waits
    try:
        with stop_message(lambda: CLOSED):
            stdout().print(Text.assemble(("viewer  ", "cyan"), viewer.address, ("  (Ctrl-C ends it)", "dim")))
            if text:
                stdout().print(text)
            viewer.wait()
    except KeyboardInterrupt:
        raise Interrupted(CLOSED, signal.SIGINT) from None
    finally:
        viewer.stop()
    return 0


def _replays_of_file(file: Path, job: Path, overrides: Sequence[str], how: Mapping[str, Any]) -> tuple[Replays, str]:
    """Prove a file's motion, and return its replays and the verdict as one line."""
    from htcp_jax.proving import proof_record, prove_file
    from htcp_jax.viewer import replays_of_file

    with progress_bar("paths", first="reading the file and building the scene") as progress:
        found = prove_file(
            file, job, overrides=overrides, progress=lambda what, done, count: progress(done, count), **how
        )
        replays = replays_of_file(found)
    return replays, "\n".join(filter(None, (proof_record.headline(found), proof_record.second_line(found))))


def _replays_and_programs(
    what: Path | None, method: str | None, overrides: Sequence[str], feed_m_s: float | None, retract: bool
) -> tuple[Replays, Callable[[int, str], PlanProgram]]:
    """Open the plans to show; if `what` is a job, plan it.

    Returns:
        The plans, and a function (scenario, method) that returns the robot program at the feed rate.
    """
    what = what and examples.example_or_path(what)
    if what is not None and not what.exists():
        raise InputError(f"{what}: no such run folder or job")
    if what is not None and what.is_dir():
        if overrides and feed_m_s is None:
            raise InputError(f"--set and --seed change a job, and {what} is a run folder; omit them")
        with progress_text(f"reading the plans in {what}"):
            found, how = open_plans(what), {"retract": retract, "overrides": overrides}
            replays = recorded_replays(found)
        return replays, lambda scenario, by: program_of(found, feed_m_s, by, scenario, **how)
    name, plan = str(what or "the default job"), plan_with_progress(job_of(what, overrides, method), what, overrides)
    of_job = name, plan.plans, 0, plan.job, feed_m_s
    return replays_of(name, plan), lambda _, by: program_of_plans(*of_job, by, retract=retract)
