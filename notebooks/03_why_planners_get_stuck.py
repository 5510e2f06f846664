# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Why planners get stuck
#
# The step QPs linearise the clearance about the last configuration. If the next target needs a configuration far away,
# the step QPs fail, and the null space of the task has to be searched. This notebook shows one such target: the
# clearance over the null space, and the direction that each optimiser finds.

# %%
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import htcp_jax
from htcp_jax.clearance import Scene
from htcp_jax.planning import methods
from htcp_jax.planning.tracking import null_space

# %% [markdown]
# ## A target where the baseline ends
#
# The arm starts in its measuring configuration, with the last joint at 0, and arrives at the inlet with its tool
# turned away from the weld.

# %%
MEASURING = {"start_rad": [0.0, -2.3, 0.5, 0.0, 0.5, 0.0], "workpiece.rotation_y_rad": 0.5}
plan = htcp_jax.plan(overrides=MEASURING, method="baseline")
plan

# %%
plan.figure()

# %% [markdown]
# ## The null space
#
# From the last clear configuration, inverse kinematics (5b) moves the tip onto the failed target: $x_{ref}$. There $D
# < 0$: a body collides. All directions $N w$ with $|w| = 1$ keep the tip in place to first order, equation (10). The
# null space has $6 - 3 = 3$ dimensions, so the vectors $w$ form a sphere.

# %%
settings, robot = plan.job.settings, plan.robot
scene = Scene(robot, htcp_jax.make_obstacle(plan.workpiece))


def lost_target(plan):
    """The target that ended a plan, the configuration before it, and the scenario."""
    row = plan.summary.failures[0].target
    key = jax.random.key(0)
    stuck = null_space.StuckScenario(
        jnp.asarray(plan.plans.x[0, row - 1]), jnp.asarray(plan.scenario.targets[row]), key
    )
    return stuck, jax.tree.map(jnp.asarray, plan.scenario)


@jax.jit
def enter(scene, scenario, stuck):
    """The configuration at the lost target, from the one before it: Algorithm 1, line 9."""
    x, _ = htcp_jax.reanchor(scene.robot, stuck.x_previous, stuck.target, 0.1 * settings.tolerance_m)
    return null_space.anchor(scene, settings, scenario, x, stuck.target)


@jax.jit
def all_clearances(scene, scenario, xs):
    """D of every capsule [m] at each of the configurations xs."""
    return jax.lax.map(lambda x: htcp_jax.clearances(scene.robot, scene.obstacles, scenario, x), xs)


stuck, scenario = lost_target(plan)
here = enter(scene, scenario, stuck)
bodies = np.asarray(all_clearances(scene, scenario, here.x[None]))[0]
print(f"D = {1e3 * here.clearance:.2f} mm, at {robot.capsule_names[bodies.argmin()]}")

# %% [markdown]
# The picture is a map of the sphere (Mollweide projection): the clearance after one step of `alpha_rad` from $x_{ref}$
# in every direction. At white lines the nearest capsule changes. The clearance is the minimum over capsules, so it has
# a kink at these lines, and the best direction often lies on such a ridge.

# %%
LONGITUDE, LATITUDE = np.linspace(-np.pi, np.pi, 97), np.linspace(-np.pi / 2, np.pi / 2, 49)


def directions(longitude, latitude):
    """Unit vectors w."""
    across = np.cos(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=-1)


reach = settings.alpha_rad * np.asarray(htcp_jax.null_basis(htcp_jax.jacobian(robot, here.x)))
sphere = directions(*np.meshgrid(LONGITUDE, LATITUDE))
all_bodies = np.asarray(all_clearances(scene, scenario, here.x + sphere.reshape(-1, 3) @ reach.T))
all_bodies = all_bodies.reshape(*sphere.shape[:2], -1)

# %% [markdown]
# Marks show the direction that each optimiser returns. All maximise the same objective. By default they start from the
# best of 64 directions, as predicted by the nearest points at $x_{ref}$ (`first_direction: best_of_64`). SQP, interior
# point and Adam find the local maximum next to this direction. CMA-ES samples the half sphere about this direction and
# returns the best direction that it evaluated.

# %%
OPTIMISERS = {
    "nspace-sqp": ("#0072b2", "o"),
    "nspace-ip": ("#56b4e9", "s"),
    "nspace-cmaes": ("#009e73", "D"),
    "nspace-adam": ("#e69f00", "^"),
}


@partial(jax.jit, static_argnums=0)
def best_direction(method, scene, scenario, key, x):
    """The direction w that an optimiser finds at x, and the clearance one step along it [m]."""
    problem, seen, _ = null_space.sphere_problem(scene, settings, scenario, x)
    return methods.find(method).stages[0].minimise(problem, seen, key, settings)


best = {method: best_direction(method, scene, scenario, stuck.key, here.x) for method in OPTIMISERS}


def sphere_map():
    figure = Figure(figsize=(9, 4.6), dpi=120, layout="constrained")
    axes = figure.subplots(subplot_kw={"projection": "mollweide"})
    gain = 1e3 * all_bodies.min(axis=-1)
    image = axes.pcolormesh(LONGITUDE, LATITUDE, gain, cmap="cividis", shading="gouraud", rasterized=True)
    for body in np.unique(all_bodies.argmin(axis=-1)):
        ahead = all_bodies[..., body] - np.delete(all_bodies, body, axis=-1).min(axis=-1)
        axes.contour(LONGITUDE, LATITUDE, ahead, [0.0], colors="white", linewidths=0.8)
    for size, (method, (colour, marker)) in zip((260, 150, 75, 30), OPTIMISERS.items(), strict=True):
        x, y, z = best[method].w
        style = {"marker": marker, "color": colour, "edgecolors": "black", "linewidths": 0.8, "s": size, "zorder": 3}
        axes.scatter(np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1)), label=method, **style)
    axes.set(xticks=[], yticks=[])
    figure.colorbar(image, ax=axes, shrink=0.7, label="D one step away [mm]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


sphere_map()

# %%
{method: f"{1e3 * found.value:.3f} mm" for method, found in best.items()}

# %% [markdown]
# ## A recovery, step by step
#
# A recovery repeats three operations until $D > 0$: find the best direction, take a step, and move back onto the target
# by inverse kinematics. Here the better direction leads to the worse result. The three methods that chose the lower
# maximum are clear after a few steps. CMA-ES chose the higher maximum, which leads onto a ridge between two capsules,
# where its steps alternate between both sides and the clearance does not increase.

# %%
STEPS = 20


@jax.jit
def advance(scene, scenario, stuck, x, w):
    """One step along w, and back onto the target."""
    x = x + settings.alpha_rad * htcp_jax.null_basis(htcp_jax.jacobian(scene.robot, x)) @ w
    x = jnp.clip(x, scene.robot.lower, scene.robot.upper)
    return null_space.anchor(scene, settings, scenario, x, stuck.target)


def recovery(method, scenario, stuck, start):
    """D [mm] at the start and after every step, up to the first clear configuration."""
    found, here = [1e3 * float(start.clearance)], start
    while found[-1] <= 0 and len(found) <= STEPS:
        key = jax.random.fold_in(stuck.key, len(found) - 1)
        here = advance(scene, scenario, stuck, here.x, best_direction(method, scene, scenario, key, here.x).w)
        found.append(1e3 * float(here.clearance))
    return found


def steps_chart(self_motions):
    figure = Figure(figsize=(9, 3.6), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.axhspan(0, 1e3, color="#e8f1e8")
    axes.axhline(0, color="#22303c", linewidth=1)
    for width, method in zip((5, 3.6, 2.4, 1.2), self_motions, strict=True):  # so that equal lines show
        colour, marker = OPTIMISERS[method]
        style = {"color": colour, "marker": marker, "markersize": 3 + 1.5 * width, "linewidth": width}
        axes.plot(self_motions[method], label=f"{method}, {len(self_motions[method]) - 1} steps", **style)
    low, high = min(map(min, self_motions.values())), max(map(max, self_motions.values()))
    space = 0.12 * (high - low)
    axes.set(xlim=(0, STEPS), ylim=(low - space, max(high, 0) + space))
    axes.set(xlabel="null-space step", ylabel="clearance D [mm]")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


steps_chart({method: recovery(method, scenario, stuck, here) for method in OPTIMISERS})

# %% [markdown]
# ## Where steepest ascent fails
#
# Now the same duct is tilted by 0.1 rad less. The baseline ends at the same target, and the best direction of every
# step leads onto a ridge at which the arm is 20 mm inside the wall. Only the interior point method becomes clear: its
# barrier keeps it away from the exact maximum, so it leaves the ridge on the other side.

# %%
MEASURING["workpiece.rotation_y_rad"] = 0.4
plan = htcp_jax.plan(overrides=MEASURING, method="baseline")
stuck, scenario = lost_target(plan)
here = enter(scene, scenario, stuck)
steps_chart({method: recovery(method, scenario, stuck, here) for method in OPTIMISERS})

# %% [markdown]
# Is there a clear configuration at all? To find out, move through the null space along 48 random directions and ignore
# collisions on the way: 100 steps of 0.02 rad each, with the tip on the target. This is what `nspace-sample` does.

# %%
SELF_MOTIONS, SELF_MOTION_STEPS, LENGTH_RAD = 48, 100, 0.02


@jax.jit
def walk(scene, scenario, stuck, x, direction):
    """D [m] along one self-motion from x."""
    robot = scene.robot

    def step(state, _):
        x, v = state
        basis = htcp_jax.null_basis(htcp_jax.jacobian(robot, x))
        v = basis @ (v @ basis)
        v = v / jnp.linalg.norm(v)
        x = jnp.clip(x + LENGTH_RAD * v, robot.lower, robot.upper)
        x, _ = htcp_jax.reanchor(robot, x, stuck.target, 0.1 * settings.tolerance_m, iterations=3)
        return (x, v), jnp.min(htcp_jax.clearances(robot, scene.obstacles, scenario, x))

    start = x, htcp_jax.null_basis(htcp_jax.jacobian(robot, x)) @ direction
    return jax.lax.scan(step, start, length=SELF_MOTION_STEPS)[1]


random = np.random.default_rng(0).standard_normal((SELF_MOTIONS, 3))
random /= np.linalg.norm(random, axis=1, keepdims=True)
self_motions = [walk(scene, scenario, stuck, here.x, direction) for direction in random]
along = 1e3 * np.concatenate([np.full((SELF_MOTIONS, 1), here.clearance), np.stack(self_motions)], axis=1)


def self_motions_chart():
    figure = Figure(figsize=(9, 3.8), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.axhspan(0, 1e3, color="#e8f1e8")
    axes.axhline(0, color="#22303c", linewidth=1)
    out = (along > 0).any(axis=1)
    distance = LENGTH_RAD * np.arange(SELF_MOTION_STEPS + 1)
    axes.plot(distance, along[~out].T, color="#9aa3ab", linewidth=0.7)
    axes.plot(distance, along[out].T, color="#d55e00", linewidth=1.4)
    axes.set(xlim=(0, distance[-1]), ylim=(max(along.min(), -150), max(20, along.max() + 5)))
    axes.set(xlabel="distance moved through the null space [rad]", ylabel="clearance D [mm]")
    axes.set_title(f"{out.sum()} of {SELF_MOTIONS} self-motions come to a clear configuration", loc="left", fontsize=11)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


self_motions_chart()

# %% [markdown]
# More than half of the directions lead to a clear configuration, most after more than half a radian. So clear
# configurations exist, but too far away for steepest ascent. The arm must also be able to move there, but the
# self-motions pass through the wall, and so does the straight joint path from the last clear configuration. By default
# `nspace-sample` rejects such a step, and its plan ends at this target:

# %%
sampled = htcp_jax.plan(overrides=MEASURING, method="nspace-sample")
sampled.failure()

# %% [markdown]
# Without this check (`path_check: none`), `nspace-sample` takes the step and tracks further targets. The motion's
# verification then finds that the arm collides on the segment to this target, so no further target is executable.

# %%
unchecked = htcp_jax.plan(overrides={**MEASURING, "settings.path_check": "none"}, method="nspace-sample")
frame = unchecked.frame()
columns = ["target", "status", "joint_step_rad", "path_clear", "segment_status"]
print({"checked": sampled.facts()["can be run"], "unchecked": unchecked.facts()["can be run"]})
frame.loc[frame.recovery > 0, columns]

# %% [markdown]
# ## Tracked is not executable
#
# Take another pose of the part, with the default start. `nspace-sqp` tracks all targets: it finds a clear configuration
# for each. But the arm must also move between them. After a recovery the configuration is far from the previous one,
# and on the straight joint path between the two the tool leaves the weld, so the motion ends there. `beam` keeps
# configurations in several basins of attraction at once, each connected to the start by a proven motion, and chooses
# among them at the end of the path.

# %%
POSE = {"workpiece.rotation_y_rad": 0.3, "workpiece.rotation_z_rad": -0.2}
both = {method: htcp_jax.plan(overrides=POSE, method=method) for method in ("nspace-sqp", "beam")}
{method: {"tracked": str(plan.summary.tracked), **plan.motion_summary.facts()} for method, plan in both.items()}

# %% [markdown]
# The plots compare both plans along the path: the clearance at the targets, and the tool's largest distance from the
# line between two targets, at 50 samples of every joint path. The dashed line is the allowed distance. Pale points are
# targets that are not executable.

# %%
PLACES = 50
tcps = jax.jit(jax.vmap(htcp_jax.tcp_position, (None, 0)))


def off_line(plan, target):
    """How far the TCP is at most from the line to a target of the path [m], on the segment from the one before."""
    plans, (a, b) = plan.plans, plan.scenario.targets[target - 1 : target + 1]
    x = np.concatenate([plans.before(0, target)[None], plans.via_points.on_segment(0, target), plans.x[:1, target]])
    places = np.concatenate([np.linspace(*ends, PLACES) for ends in pairwise(x)])
    along = np.asarray(tcps(plan.robot, places)) - a
    share = np.clip(along @ (b - a) / max((b - a) @ (b - a), 1e-12), 0, 1)
    return np.linalg.norm(along - share[:, None] * (b - a), axis=1).max()


def motions_chart(plans_by_method):
    figure = Figure(figsize=(9, 5.6), dpi=120, layout="constrained")
    clearance, away = figure.subplots(2, sharex=True)
    for (method, plan), colour in zip(plans_by_method.items(), ("#0072b2", "#d55e00"), strict=True):
        reported, first = plan.motion_summary, int(plan.scenario.on_path) + 1
        targets = np.arange(plan.summary.tracked)
        on_path = targets[targets >= first]
        distance = [1e3 * off_line(plan, t) for t in on_path]
        for axes, x, y in (
            (clearance, targets, 1e3 * plan.plans.clearance[0, targets]),
            (away, on_path, np.array(distance)),
        ):
            executable = x < reported.end.executable
            axes.plot(x, y, ".-", color=colour, alpha=0.25, markersize=3, linewidth=0.8)
            axes.plot(x[executable], y[executable], ".-", color=colour, markersize=4, label=method)
    away.axhline(1e3 * settings.tube_m, color="#22303c", linewidth=1, linestyle="--")
    clearance.set(yscale="log", ylabel="clearance D [mm]")
    away.set(yscale="log", ylabel="TCP off its line [mm]", xlabel="target")
    for axes in (clearance, away):
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*clearance.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


motions_chart(both)

# %% [markdown]
# ## The beam width
#
# The beam width is the maximum number of configurations kept per target; self-motions add configurations where there
# are few. With a width of one, the method is a local search: it leaves each dead end by a dwell, in which the arm
# changes its configuration while the tool stays. With a larger width, the method has several motions to choose from at
# the end of the path. It returns the one with the fewest dwells, and among equal ones the one with the lowest cost by
# equation (3).

# %%
BEAM_WIDTHS = 1, 4, 16, 64


def with_beam_width(count):
    """Figures of the motion by a beam search of this width."""
    own = {"settings.beam_width": count, "settings.min_beam_width": min(count, settings.min_beam_width)}
    reported = htcp_jax.plan(overrides=POSE | own, method="beam").motion_summary
    return {
        "executable": reported.end.executable,
        "dwells": len(reported.dwells),
        "cost [rad2]": round(reported.cost_rad2, 3),
    }


{count: with_beam_width(count) for count in BEAM_WIDTHS}
