"""`htcp program`: time a plan, and write it as a robot program for a controller."""

import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import typer
from jaxtyping import Float
from rich.text import Text

from htcp_jax.cli.feed import Feed, OneWay, ProgramKeys
from htcp_jax.cli.methods import RunMethod
from htcp_jax.cli.output import Json, print_facts, print_json, print_table, progress_bar, progress_text, stdout
from htcp_jax.cli.program_file import (
    check_deviation,
    deviation_facts,
    deviation_records,
    note_limits,
    part_facts,
    proof_facts,
    proof_record,
    refusal,
    write_files,
)
from htcp_jax.cli.timing import print_timing, refuse_untimed, timed, timing_records
from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import JointLimits, read_joint_limits
from htcp_jax.jobs import build
from htcp_jax.proving import ProgramProof, prove_with_exact_corners
from htcp_jax.report import program_facts
from htcp_jax.runs import open_plans, open_run, plan_folder, timing_file
from htcp_jax.spec import PlanConfig
from htcp_jax.spec import feed as feed_rates
from htcp_jax.trajectory import (
    FORMATS,
    FileMotion,
    PeakTorque,
    PlanProgram,
    ProgramFigures,
    Share,
    check_ranges,
    deviations,
    format_of,
    joined_configurations,
    limits_of_job,
    limits_overrides,
    program_figures,
    program_of,
    requested_feeds,
    with_program,
    worst_deviation,
)
from htcp_jax.validation import check_timed

REFUTED, OVERLOADED, UNDECIDED = 1, 3, 4  # exit codes
CHECKED = (
    "{refuted} of {configurations:,} configurations refuted; minimum clearance {clearance_min_mm:.3g} mm, "
    "maximum path deviation {off_max_mm:.3g} mm"
)

Run = Annotated[Path, typer.Argument(metavar="RUN", help="Output folder of htcp plan or htcp sweep.")]
Format = Annotated[str | None, typer.Option(metavar="NAME", help=f"File format: {', '.join(FORMATS)}; by default csv.")]
Out = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Output file; its name without the ending is the program's name.")
]
All = Annotated[bool, typer.Option("--all", help="Time every scenario of a sweep; write no program.")]
Scenario = Annotated[int | None, typer.Option(metavar="K", help="Number of the scenario in the sweep; by default 0.")]
Check = Annotated[bool, typer.Option("--check", help="Check the configuration at every millisecond with MuJoCo.")]
AllowEffort = Annotated[
    bool, typer.Option("--allow-effort", help="Return exit code 0 if torques exceed the effort limits.")
]
Limits = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="File with joint limits, such as MoveIt's joint_limits.yaml; overrides the job. "
        "A motion outside its ranges is refused.",
    ),
]
MaxPoints = Annotated[
    str | None,
    typer.Option(
        metavar="N",
        help="Maximum number of configurations in the file, which are placed where needed; or fewest: no more than "
        "the path's tolerance requires.",
    ),
]
AllowDeviation = Annotated[
    bool,
    typer.Option("--allow-deviation", help="Write a file that deviates from the path by more than its tolerance."),
]
Step = Annotated[
    float | None,
    typer.Option(metavar="MS", help="Time between configurations [ms]; the default depends on the format."),
]


def program(
    run: Run,
    feed: Feed = None,
    out: Out = None,
    all_: All = False,
    format: Format = None,
    scenario: Scenario = None,
    method: RunMethod = None,
    one_way: OneWay = False,
    check: Check = False,
    allow_effort: AllowEffort = False,
    step_ms: Step = None,
    max_points: MaxPoints = None,
    allow_deviation: AllowDeviation = False,
    limits: Limits = None,
    overrides: ProgramKeys = None,
    as_json: Json = False,
) -> int:
    """Time the motion of a plan and write it as a robot program for a controller.

    The motion leads from home, or the start, along the path to the last target and back. Along the path the TCP moves
    at the required feed rate: of --feed, else of the seam, else of the job; elsewhere the arm moves as fast as the
    joint limits allow. The table lists where a limit
    reduces the feed, the feed there, and the limiting joint. Limits and controller data are in the job's section
    program; --limits takes precedence over it, and --set over both.

    Between the configurations of a file the controller moves by itself. The table states how far it then is from the
    program's motion: the configurations joined linearly and, if the file has accelerations, by quintic splines. More
    than the path's tolerance is refused, unless --allow-deviation is passed.

    With --all, every scenario of a sweep is timed instead: cycle time, feed and limits become columns of the run, for
    htcp report and htcp gate. Scenarios that are timed already with the same feed and limits are skipped.

    The file is then read back, as htcp prove reads it, and its motion is proven clear between the configurations, too.
    A file whose motion collides is not written. Poses (jbi) are read back, but the motion between them is not proven.

    Exit codes: 0; 1 if the file's motion collides, or if --check refutes a configuration; 3 if a torque exceeds its
    limit; 4 if the file's motion is neither proven nor refuted; 2 on bad input or if the plan does not lead to its last
    target. The file is written in all cases but the first of code 1 and code 2.

    \b
    Examples:
      htcp plan
      htcp program out/plan --feed 20mm/s --out weld.csv
      htcp program out/plan --feed 20mm/s --format ros --out weld.yaml
      htcp program out/plan --feed 20mm/s --format ros --max-points 200 --out weld.yaml
      htcp sweep sweeps/workpiece --methods beam
      htcp program out/workpiece --scenario 17 --feed 1.2m/min --out pose.csv --set program.full_speed_s=0.4
      htcp program out/workpiece --all --feed 20mm/s
    """
    if all_:
        of_one = {"--out": out, "--format": format, "--scenario": scenario, "--step-ms": step_ms}
        of_one |= {"--max-points": max_points}
        given = [name for name, value in of_one.items() if value is not None]
        flags = {"--one-way": one_way, "--check": check, "--allow-effort": allow_effort}
        flags |= {"--allow-deviation": allow_deviation}
        if given := given + [name for name, is_set in flags.items() if is_set]:
            raise InputError(f"{given[0]} applies to one program, and --all times every scenario; omit one of them")
        return _time_all(run, feed, method, limits, overrides or (), as_json)
    if out is None:
        raise InputError("--out is missing: pass --out FILE, or --all to time every scenario of a sweep")
    format, scenario = format or "csv", scenario or 0
    format_of(format)
    if step_ms is not None and max_points is not None:
        raise InputError("--max-points chooses the times of the configurations; omit --step-ms")
    if feed is not None:
        feed_rates.feed_of(feed)  # check it before files are opened
    most = None if max_points is None else _number_of_points(max_points)
    plans, step_s = open_plans(run), _step_seconds(step_ms)
    _note_feeds(feed, plans.config)
    in_file = _limits_in_file(limits, plans.config)
    changes = [*in_file.overrides, *(overrides or ())]
    feed_m_s = requested_feeds(feed, with_program(plans.config, changes))
    with progress_text("building the scene and timing the motion") as show:
        made = program_of(plans, feed_m_s, method, scenario, retract=not one_way, overrides=changes)
        if in_file.stated is not None:
            check_ranges(in_file.stated, made.robot, made.program.motion, str(run))
        _print_note(in_file)
        show("choosing the file's configurations")
        file, is_chosen = made.in_file(format, step_s, most), step_ms is not None or max_points is not None
        show(f"measuring the deviation of {len(file.timed.x):,} configurations")
        deviation = deviations(made.robot, made.program, file)
        files = made.files(format, out.stem, file)
        check_deviation(made, format, file, deviation, is_chosen=is_chosen, is_allowed=allow_deviation)
        files, proof = prove_with_exact_corners(made, format, out.stem, file, files, progress=show)
    if proof.is_refuted:
        print(f"htcp: {refusal(proof)}; nothing is written", file=sys.stderr)
        return REFUTED
    if made.job.program.process is not None and (stops := made.stops_within_seams):
        why = "the task leaves no slack to round these corners; see stop in the table"
        what = f"the arm stops within a seam ({stops} stops), and the outputs of program.process stay on"
        warnings.warn(f"{what}: {why}", stacklevel=1)
    torque, found = made.peak_torque, program_figures(made.program, made.limits)
    facts = program_facts.near_part(made.job) | program_facts.way_back(made.job, made.program)
    facts["torque"] = program_facts.torque_text(torque)
    paths = write_files(out, files)
    note_limits(format, len(file.timed.x), len(files) - 1)
    checked = _check_motion(run, made, scenario, file if is_chosen else None) if check else {}
    if overloaded := torque is not None and torque.share > 1:
        warnings.warn(f"torque is {facts['torque']}; pass --allow-effort to accept it", stacklevel=1)
    manipulability = made.manipulability if found.drops else np.zeros(0)
    written = _Written(found, manipulability, torque, checked, facts, paths, proof, made.seam_feeds)
    if proof.is_undecided:
        warnings.warn(refusal(proof), stacklevel=1)
    if as_json:
        tolerance = {"path_tolerance_mm": 1e3 * made.job.settings.tube_m, "deviations": deviation_records(deviation)}
        _print_record(written, {"configurations": len(file.timed.x), **tolerance})
    else:
        _print_written(f"{made.robot.name}: {format}", written, deviation_facts(made, format, file, deviation))
    if checked.get("refuted"):
        return REFUTED
    if overloaded and not allow_effort:
        return OVERLOADED
    return UNDECIDED if proof.is_undecided else 0


class _Written(NamedTuple):
    """A program in a file, and what is printed of it."""

    found: ProgramFigures
    manipulability: Float[np.ndarray, "T"]  # at all targets; empty if the feed never drops
    torque: PeakTorque | None
    checked: dict[str, int | float]  # result of --check; empty without it
    facts: dict[str, str]  # the torque, and the speed near the part if it is not full speed
    paths: dict[Path, range]  # the files, the main one first, with the rows of their configurations
    proof: ProgramProof
    seam_feeds: Mapping[str, float]  # feed rate of each seam [m/s]; empty if all are equal


def _print_record(written: _Written, deviation: dict) -> None:
    """Print a program's figures, its largest torque, its file's deviation, the result of --check and files as JSON."""
    found, manipulability, torque, checked, _, paths, proof, seam_feeds = written
    record = {key: value for key, value in found._asdict().items() if key != "drops"}
    record |= {
        "feed_drops": program_facts.drop_table(found, manipulability).records(),
        "shares": _share_record(found.shares),
    }
    record |= {"path_shares": _share_record(found.path_shares), "peak_torque": torque and torque._asdict()}
    record["seam_feeds_m_s"] = dict(seam_feeds)
    parts = [{"file": str(path), "first": rows.start, "configurations": len(rows)} for path, rows in paths.items()]
    record |= deviation | {"proof": proof_record(proof)}
    print_json({**record, "check": checked or None, "file": str(next(iter(paths))), "files": parts})


def _print_written(title: str, written: _Written, deviation: dict[str, str]) -> None:
    """Print what `_print_record` prints as a table of facts, and a table of the feed drops."""
    found, manipulability, _, checked, facts, paths, proof, seam_feeds = written
    by_mujoco = {"by MuJoCo": CHECKED.format(**checked)} if checked else {}
    files = {"file": str(next(iter(paths))), **part_facts(paths)}
    checks = {**deviation, **proof_facts(proof), **by_mujoco}
    print_facts(title, {**program_facts.facts_of(found, seam_feeds), **facts, **checks, **files})
    if not found.drops:
        return
    stdout().print()
    print_table(stdout(), program_facts.drop_table(found, manipulability))
    if not np.isnan(manipulability).all():
        middle = f"its median on the path is {np.nanmedian(manipulability):.3f} m/rad"
        stdout().print(Text(f"manipulability: the minimum there; {middle}.", style="dim"))
    if any(drop.reason == program_facts.STOP for drop in found.drops):
        stdout().print(
            Text(f"{program_facts.STOP}: the arm starts or stops there, as at both ends of the path.", style="dim")
        )


class _LimitsInFile(NamedTuple):
    """Limits in the file of --limits."""

    stated: JointLimits | None = None  # None: no file
    overrides: Sequence[str] = ()  # those that are overrides of the section `program`
    note: str | None = None  # one line on elements without effect


def _limits_in_file(file: Path | None, job: PlanConfig) -> _LimitsInFile:
    if file is None:
        return _LimitsInFile()
    robot = build.robot_of(job.robot, job.cell, job.tree)
    stated = read_joint_limits(file, robot.all_joint_names, robot.name)
    overrides = limits_overrides(stated, robot, limits_of_job(job, robot))
    speed = None if robot.coupling else np.asarray(robot.speed, float)  # joints that follow have no own limit
    return _LimitsInFile(stated, overrides, stated.note(speed=speed))


def _print_note(in_file: _LimitsInFile) -> None:
    if in_file.note:
        warnings.warn(in_file.note, Note, stacklevel=1)


def _time_all(
    folder: Path, feed: str | None, method: str | None, limits: Path | None, overrides: Sequence[str], as_json: bool
) -> int:
    if (folder / plan_folder.SUMMARY).exists():
        raise InputError(f"{folder} contains one plan of htcp plan; --all needs a run of htcp sweep")
    run = open_run(folder)
    in_file = _limits_in_file(limits, run.config)
    run = timed(run, feed, None if method is None else (method,), [*in_file.overrides, *overrides], in_file.stated)
    _print_note(in_file)
    methods = [name for name in run.methods if run.timing(name)] if method is None else [method]
    refuse_untimed(run, methods)
    if as_json:
        print_json({"run": str(folder), "methods": timing_records(run, methods)})
        return 0
    stdout().print(Text(run.manifest.name, style="bold"))
    print_timing(run, methods)
    stdout().print(Text.assemble(("files  ", "cyan"), str(run.folder / timing_file.TIMING)))
    return 0


def _check_motion(run: Path, made: PlanProgram, scenario: int, file: FileMotion | None) -> dict[str, int | float]:
    """Check the program's motion by MuJoCo, or, if `file` is not None, the motion of the file as a player joins it."""
    timed = made.program.timed(made.program.long_step_s(1e-3))
    if file is not None:
        joined = worst_deviation(deviations(made.robot, made.program, file)).joined
        timed = timed._replace(x=joined_configurations(made.program, file.timed, joined, timed.time_s))
    with progress_bar("configurations") as progress:
        found = check_timed(run, timed, made.method, scenario, progress=progress)
    lengths = {"clearance_min_mm": 1e3 * found.clearance_min_m, "off_max_mm": 1e3 * found.off_max_m}
    return {"configurations": len(timed.x), "refuted": found.refuted, **lengths}


def _number_of_points(text: str) -> int | Literal["fewest"]:
    if text == "fewest":
        return "fewest"
    if not text.isdecimal() or int(text) < 2:
        raise InputError(f"--max-points is {text!r}; valid: a whole number, at least 2, or fewest")
    return int(text)


def _step_seconds(step_ms: float | None) -> float | None:
    if step_ms is not None and not 0.1 <= step_ms <= 1000:
        raise InputError(f"--step-ms is {step_ms}; valid: 0.1 to 1000")
    return None if step_ms is None else 1e-3 * step_ms


def _share_record(found: list[Share]) -> dict[str, dict]:
    return {each.limit: {"share": each.share, "joint": each.joint, "time_s": each.time_s} for each in found}


def _note_feeds(feed: str | None, job: PlanConfig) -> None:
    """Note that --feed replaces the feeds of seams."""
    own = [f"{seam.name} ({seam.feed})" for seam in job.workpiece.seams if seam.feed is not None]
    if feed is not None and own:
        warnings.warn(f"--feed {feed} replaces the feeds of seams: {', '.join(own)}", Note, stacklevel=1)
