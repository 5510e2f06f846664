"""Time of an exact clearance query with its gradient, by the index and by brute force, on growing clouds.

    python -m benchmarks clearance [--set KEY=VALUE]... [--json FILE]

Configurations are near the nominal plan. Brute force, compiled and vectorised, computes all distances and each body's
minimum, without a gradient. A second table has the verdict "clear by the margin": without further knowledge, and with
the nearest contact at a configuration 0.01 rad (standard deviation per joint) away.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import hardware
from benchmarks.figures import Figure, save
from htcp_jax.caching import cache_folder
from htcp_jax.clearance import Obstacles, is_clear, minimum_clearance
from htcp_jax.clearance.distance.cloud_tree import build_index
from htcp_jax.clearance.obstacles.linearisation import linearise
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.motion import Problem
from htcp_jax.planning.batch import plan

ROOT = Path(__file__).resolve().parents[1]
CLOUDS = (5_000, 50_000, 500_000)
QUERIES = 1024
NAMES = "gradient", "alone", "path of 20"  # names of the timed queries, as in RESULTS.md


def main() -> None:
    """Measure the times for every number of points, and print them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the times as JSON, too")
    chosen = parser.parse_args()
    cache_folder.enable()
    job = load_config(ROOT / "configs/duct.yaml", chosen.overrides)
    robot, workpiece, where = scene(job)
    random = np.random.default_rng(0)
    tracked = plan(Problem.of(robot, workpiece, where, job.settings, check_paths=False), "nspace-sqp").x[0]
    tracked = tracked[np.isfinite(tracked).all(axis=1)]
    x = tracked[random.integers(len(tracked), size=QUERIES)] + random.normal(0, 0.03, (QUERIES, tracked.shape[1]))
    where = jax.tree.map(jnp.asarray, where)
    cloud, *others = make_obstacle(workpiece)

    print(hardware.line())
    print("  points  D of all bodies, gradient  D alone  path of 20  brute force, D  ratio")
    rows, verdicts = [], []
    for size in CLOUDS:
        points = _cloud(np.asarray(workpiece.cloud), size, random)
        obstacle = (replace(cloud, points=jnp.asarray(points), index=build_index(points)), *others)
        ours = _time(lambda q, o=obstacle: linearise(robot, o, where, q), x)
        alone = _time(lambda q, o=obstacle: minimum_clearance(robot, o, where, q), x)
        path = _time(lambda q, o=obstacle: _path(robot, o, where, q), x)
        brute = _time(lambda q, o=obstacle: _brute_force(robot, o, where, q), x[: max(8, QUERIES * 500 // size)])
        print(row(size, ours, alone, path, brute))
        times = zip(NAMES, (ours, alone, path), strict=True)
        rows += [Figure(f"{size:,} points, {name}", us, "us") for name, us in times]
        verdicts.append(_verdicts(robot, obstacle, where, x))
    print("  points  clear by the margin   clear")
    for size, (share, us) in zip(CLOUDS, verdicts, strict=True):
        print(f"{size:8,} {us:17.2f} us {share:7.0%}")
        rows.append(Figure(f"{size:,} points, verdict", us, "us"))
    save(chosen.json, rows)


def _verdicts(robot, obstacle: Obstacles, where, x: np.ndarray) -> tuple[float, float]:
    """Return the share of clear configurations, and the time of a verdict [us]."""
    each = lambda function: jax.jit(lambda rows: jax.lax.map(function, rows))(x)  # noqa: E731
    clear = lambda q: is_clear(robot, obstacle, where, q, where.margin_m)  # noqa: E731
    found, distance = each(clear), each(lambda q: minimum_clearance(robot, obstacle, where, q))
    assert (found == (distance > where.margin_m)).all()
    return float(found.mean()), _time(clear, x)


def row(size: int, ours: float, alone: float, path: float, brute: float) -> str:
    """Return a row of the table: the number of points, and times per query [us]."""
    return f"{size:8,} {ours:23.1f} us {alone:5.1f} us {path:8.1f} us {brute:12.0f} us {brute / ours:6.0f}"


def _cloud(points: np.ndarray, size: int, random) -> np.ndarray:
    """Return `size` points: a part of the cloud, or copies of the cloud with 1 mm of noise."""
    if size <= len(points):
        return points[random.permutation(len(points))[:size]]
    more = np.tile(points, (-(-size // len(points)), 1))[:size]
    return more + random.normal(0, 1e-3, more.shape)


def _brute_force(robot, obstacle: Obstacles, where, x):
    """Return every body's minimum distance from all points, without a gradient."""
    p, q = capsule_segments(robot, x)
    T = where.T_world_workpiece
    p, q = (p - T[:3, 3][None]) @ T[:3, :3], (q - T[:3, 3][None]) @ T[:3, :3]
    x, y, z = obstacle[0].points.T

    def body(p, q):
        d = q - p
        ax, ay, az = x - p[0], y - p[1], z - p[2]
        s = jnp.clip((ax * d[0] + ay * d[1] + az * d[2]) / jnp.maximum(d @ d, 1e-30), 0, 1)
        return jnp.sqrt(jnp.min((ax - s * d[0]) ** 2 + (ay - s * d[1]) ** 2 + (az - s * d[2]) ** 2))

    return jax.vmap(body)(p, q) - robot.capsule_radius


def _path(robot, obstacle: Obstacles, where, x):
    steps = x[None, :] + jnp.linspace(0.0, 0.01, 19)[:, None]
    return jnp.all(jax.vmap(lambda step: is_clear(robot, obstacle, where, step))(steps))


def _time(function, x: Any, repeats: int = 5) -> float:
    """Return the time per configuration [us], the median of some runs after the first one.

    On a CPU a few configurations form a batch, as in the engine; on a GPU, all of them.
    """
    count = len(jax.tree.leaves(x)[0])
    side_by_side = 4 if jax.default_backend() == "cpu" else count
    program = jax.jit(lambda x: jax.lax.map(function, x, batch_size=side_by_side))
    jax.block_until_ready(program(x))
    spent = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(program(x))
        spent.append(time.perf_counter() - began)
    return 1e6 * float(np.median(spent)) / count


if __name__ == "__main__":
    main()
