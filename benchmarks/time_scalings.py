"""Time scaling of air moves by this package, copp-py and toppra: durations, and times to compute them.

    pip install toppra copp-py
    python -m benchmarks time-scalings out/plan [out/other ...]

All get the same rounded curve on the same grid. toppra and copp-py's second order do not limit the jerk; the others do.
A package that is not installed is reported. The table has one row per package and air move: the duration, the median
time to compute it, and the largest shares of the velocity, acceleration and jerk limits on the timed curve, by finite
differences at 1 ms.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks import hardware
from htcp_jax.jobs.build import scene
from htcp_jax.model.scenario_setup import with_own_tool
from htcp_jax.motion.motion import motion
from htcp_jax.runs import open_plans
from htcp_jax.trajectory.blends import blends, motion_slack
from htcp_jax.trajectory.limits import MotionLimits, joint_limits
from htcp_jax.trajectory.path import PathCurve, path_of_blend
from htcp_jax.trajectory.time_scaling import time_scaling

FEED_M_S, STEP_S, REPEATS = 0.02, 1e-3, 5
Found = Callable[[np.ndarray], np.ndarray]  # places at times


def own(path: PathCurve, limits: MotionLimits) -> tuple[float, Found]:
    """Return duration and time scaling by this package."""
    scaling = time_scaling(path, limits)
    return scaling.speed.duration_s, lambda time: scaling.speed.at(time)[0]


def copp_robot(path: PathCurve, limits: MotionLimits, jerk: bool):
    """Robot of copp-py, with one station per place of the grid."""
    import copp_py as copp

    robot, found = copp.Robot(path.curve.x.shape[1]), path.at(path.place)
    robot.append_s(path.place)
    robot.set_q(found.x, found.first, found.second, 0, dddq=found.third)
    length = len(path.place)
    robot.add_velocity_limits(limits.velocity, -limits.velocity, start_idx_s=0, length=length)
    robot.add_acceleration_limits(limits.acceleration, -limits.acceleration, start_idx_s=0, length=length)
    if jerk:
        robot.add_jerk_limits(limits.jerk, -limits.jerk, start_idx_s=0, length=length)
    return robot


def between(place: np.ndarray, square: np.ndarray) -> tuple[float, Found]:
    """Time scaling by the squared speed at places, with constant acceleration between them."""
    speed = np.sqrt(np.maximum(square, 0.0))
    step = 2 * np.diff(place) / np.maximum(speed[:-1] + speed[1:], 1e-12)
    when = np.append(0.0, np.cumsum(step))
    push = np.diff(speed) / step

    def at(time: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(when, time, side="right") - 1, 0, len(step) - 1)
        t = time - when[k]
        return place[k] + t * (speed[k] + t * push[k] / 2)

    return float(when[-1]), at


def copp_2(path: PathCurve, limits: MotionLimits) -> tuple[float, Found]:
    """Time-optimal scaling with limits of velocity and acceleration, by reachability (copp-py)."""
    import copp_py as copp

    robot = copp_robot(path, limits, jerk=False)
    problem = copp.solver.topp2_ra.Problem(robot.constraints, (0, len(robot) - 1), (0.0, 0.0))
    return between(path.place, copp.solver.topp2_ra.solve(problem))


def copp_3(path: PathCurve, limits: MotionLimits) -> tuple[float, Found]:
    """Scaling with limited jerk, by a linear programme about the solution of second order (copp-py)."""
    import copp_py as copp

    robot = copp_robot(path, limits, jerk=True)
    problem = copp.solver.topp2_ra.Problem(robot.constraints, (0, len(robot) - 1), (0.0, 0.0))
    about = copp.solver.topp2_ra.solve(problem)
    problem = copp.solver.topp3_lp.Problem(robot.constraints, about, a_boundary=(0.0, 0.0), b_boundary=(0.0, 0.0))
    profile = copp.solver.topp3_lp.solve(problem)
    duration, times = copp.interpolation.s_to_t_topp3(path.place, profile)
    return float(duration), lambda time: copp.interpolation.t_to_s_topp3_samples(path.place, profile, times, time)


def toppra_(path: PathCurve, limits: MotionLimits) -> tuple[float, Found]:
    """Time-optimal scaling by reachability, on the curve itself (toppra)."""
    import toppra
    from toppra import algorithm, constraint
    from toppra.interpolator import AbstractGeometricPath

    class Geometric(AbstractGeometricPath):
        dof, path_interval = path.curve.x.shape[1], np.array([0.0, path.place[-1]])

        def __call__(self, places, order=0):
            found = path.at(np.atleast_1d(np.asarray(places, float)))[order]
            return found if np.ndim(places) else found[0]

        @property
        def waypoints(self):
            return path.place, path.at(path.place).x

    toppra.setup_logging("WARNING")
    either = [np.stack([-limit, limit], axis=1) for limit in limits[:2]]
    bounds = [constraint.JointVelocityConstraint(either[0]), constraint.JointAccelerationConstraint(either[1])]
    instance = algorithm.TOPPRA(bounds, Geometric(), gridpoints=path.place, solver_wrapper="seidel")
    _, speed, _ = instance.compute_parameterization(0.0, 0.0)
    return between(path.place, speed**2)


SCALINGS = {"own": own, "copp-py, 2nd order": copp_2, "copp-py, 3rd order": copp_3, "toppra": toppra_}


def paths(folder: str) -> Iterator[tuple[str, PathCurve, MotionLimits]]:
    """Yield name, path and limits of each air move in a plan's motion."""
    found = open_plans(folder)
    plans, job = found.plans(found.methods[0]), found.jobs[0]
    robot, _, scenario = scene(job)
    robot, scenario = with_own_tool(robot, scenario)
    whole, limits = motion(plans, 0, int(scenario.on_path), retract=True), joint_limits(robot)
    parts = blends(robot, whole, motion_slack(plans, 0, whole, job.settings.tube_m), limits, FEED_M_S)
    for k, part in enumerate(part for part in parts if not part.on_process):
        yield f"{folder} {k}, {len(part.row)} legs", path_of_blend(robot, part), limits


def row(scaling: Callable, path: PathCurve, limits: MotionLimits) -> str:
    """Return one row of the table: a time scaling on one air move, as text."""
    taken = []
    for _ in range(REPEATS):
        begin = time.process_time()
        duration, at = scaling(path, limits)
        taken.append(time.process_time() - begin)
    x = path.at(at(np.arange(0, duration, STEP_S))).x
    most = [np.abs(np.diff(x, n=n, axis=0) / STEP_S**n) / limit for n, limit in zip((1, 2, 3), limits, strict=True)]
    shares = " | ".join(f"{part.max():.2f}" if len(part) else "" for part in most)
    return f"{duration:.3f} | {1e3 * statistics.median(taken):.1f} | {shares}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", help="that htcp plan wrote")
    print(hardware.line())
    print("| motion | time scaling | duration s | found in ms | of v | of a | of j |\n|---|---|---|---|---|---|---|")
    for folder in parser.parse_args().folders:
        for name, path, limits in paths(folder):
            for title, scaling in SCALINGS.items():
                try:
                    print(f"| {name} | {title} | {row(scaling, path, limits)} |", flush=True)
                except ImportError:
                    print(f"| {name} | {title} | not installed | | | | |")
                except Exception as error:  # of a solver: it found no solution
                    print(f"| {name} | {title} | none: {' '.join(str(error).split())[:60]} | | | | |")


if __name__ == "__main__":
    main()
