"""Public problems of path following with full poses, by their own rules: CppFlow's problems, and IKLink's path.

    python -m benchmarks paths DATA [--problems A,B] [--effort 10 --runs 10]

DATA is a folder with cppflow/, iklink/ and robots/. Every problem becomes a job (`path_problems`): an arm of exactly
the published capsules, the published boxes as a cell, the tip's pose constrained at all waypoints, a free start. It is
planned three times: to compile, without smoothing for the time to the first valid plan, and with all settings. The
results are checked by the published rules alone (`path_check`).

Planning uses default settings and one thread per core. --runs N plans every problem N more times with other seeds, and
with --effort times the settings beam_width, min_beam_width and self_motions; the table has the length relative to the
shortest of them.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import htcp_jax
from benchmarks import hardware
from benchmarks.path_check import Verdicts, check, reachable
from benchmarks.path_problems import IKLINK, PathProblem, made, problems, read_problem
from htcp_jax.caching import cache_folder
from htcp_jax.settings import Settings

ROW = "{:18} {:>9} {:>6} {:>8} {:>6} {:>6} {:>9} {:>5} {:>8} {:>8} {:>7} {:>6} {:>9} {:>8}"
HEAD = (
    "problem",
    "waypoints",
    "valid",
    "first s",
    "run s",
    "cpu s",
    "compile s",
    "parts",
    "path rad",
    "slide m",
    "step",
    "reconf",
    "clear mm",
    "of best",
)
DEFAULTS = Settings()


class Planned(NamedTuple):
    """Results of a problem."""

    verdicts: Verdicts
    run_s: float  # this and the next two are sums over the parts
    cpu_s: float
    compile_s: float
    parts: int  # motions along the path; between two the arm leaves it and returns in another configuration


def planned(problem: PathProblem, **settings: Any) -> Planned:
    """Plan and check a problem.

    A path that cannot be followed in one motion continues where the motion ended, from home there. This is only for
    IKLink's problem, as the other rules have no such reconfigurations.
    """
    x, times, home = np.full((len(problem.position), len(problem.arm.moving)), np.nan), [], None
    first = 0
    while first < len(x):
        plan, spent = _planned(problem.rest(first), home, settings)
        rows = plan.plans.executable[0, plan.scenario.on_path :]
        count = int(rows.sum())
        x[first : first + count] = plan.plans.x[0, plan.scenario.on_path :][:count]
        times.append((plan.plans.run_s, spent, plan.plans.compile_s))
        home, first = (x[first + count - 1].tolist() if count else None), first + count
        if not count or problem.name != IKLINK:
            break
    return Planned(check(problem, x), *np.sum(times, axis=0).tolist(), len(times))


def _planned(problem: PathProblem, home: list[float] | None, settings: dict[str, Any]) -> tuple[htcp_jax.Plan, float]:
    """Plan a problem, and return the plan and its CPU time [s]."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        job = made(problem, Path(folder)) | {"home_rad": home}
        plan = htcp_jax.plan(job, {f"settings.{name}": value for name, value in settings.items()})
    return plan, time.process_time() - began


def row(problem: PathProblem, effort: int, runs: int) -> str:
    """Plan a problem, and format its row of the table."""
    compile_s = planned(problem).compile_s
    first, whole = planned(problem, smooth=False), planned(problem)
    others = [planned(problem, seed=seed, **_more(effort)).verdicts for seed in range(1, runs + 1)]
    found, good = whole.verdicts, int(whole.verdicts.good.sum())
    slides = any(joint.slides for joint in problem.arm.moving)
    lengths = [each.length for each in others if _counts(problem, each)]
    valid = f"{good}" if good < len(found.good) else ("yes" if _counts(problem, found) else "steps")
    return ROW.format(
        problem.name,
        len(found.good),
        valid,
        f"{first.run_s:.1f}" if _counts(problem, first.verdicts) else "-",
        f"{whole.run_s:.1f}",
        f"{whole.cpu_s:.1f}",
        f"{compile_s:.0f}",
        whole.parts,
        f"{found.length:.3f}",
        f"{found.slide_m:.3f}" if slides else "-",
        f"{np.rad2deg(np.nanmax(np.abs(found.steps[:, _hinges(problem)]))):.2f}",
        found.reconfigurations,
        f"{1e3 * np.nanmin(found.clearance_m[found.good], initial=np.inf):.2f}",
        f"{found.length / min(lengths):.3f}" if lengths else "-",
    )


def _counts(problem: PathProblem, found: Verdicts) -> bool:
    """True if all rules hold; IKLink's rules only count steps that are too long."""
    return bool(found.good.all()) if problem.name == IKLINK else found.valid


def _hinges(problem: PathProblem) -> np.ndarray:
    return np.array([not joint.slides for joint in problem.arm.moving])


def _more(effort: int) -> dict[str, int]:
    return {name: effort * getattr(DEFAULTS, name) for name in ("beam_width", "min_beam_width", "self_motions")}


def unreachable(problem: PathProblem) -> str:
    """Waypoints for which no configuration is found even without obstacles, as text."""
    lost = np.flatnonzero(~reachable(problem))
    parts = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1) if len(lost) else []
    return ", ".join(f"{part[0]} to {part[-1]}" for part in parts) or "none"


def main() -> None:
    """Print a row of results for each problem."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--problems", help="names of problems, separated by commas; default: all")
    parser.add_argument("--runs", type=int, default=0, help="number of additional runs with other seeds")
    parser.add_argument("--effort", type=int, default=10, help="factor on the beam's default settings in these runs")
    requested = parser.parse_args()
    known = problems(requested.data)
    names = known if requested.problems is None else requested.problems.split(",")
    if unknown := set(names) - set(known):
        parser.error(f"{', '.join(sorted(unknown))}: no problem; valid: {', '.join(known)}")
    cache_folder.enable()
    print(hardware.line())
    print(ROW.format(*HEAD), flush=True)
    for name in names:
        problem = read_problem(requested.data, name)
        print(line := row(problem, requested.effort, requested.runs), flush=True)
        if line.split()[2].isdecimal():
            print(
                f"  without any configuration, by inverse kinematics alone: waypoints {unreachable(problem)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
