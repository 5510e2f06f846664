"""Picture of a plan: the arm and its capsules in the workpiece cut open, and the clearance along the path.

The scene is drawn in orthographic projection from the side, in which a capsule's outline is exactly two half circles
and two lines. Drawing needs no screen.
"""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import FuncFormatter

from htcp_jax.model import Robot, Scenario, Workpiece, kinematics, surface
from htcp_jax.motion import Plans
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Obstruction
from htcp_jax.runs import motion_summary
from htcp_jax.viewer.arm_pose import arms_at
from htcp_jax.viewer.colours import (
    DWELL,
    FAILED,
    FIXTURE,
    INK,
    LINKS,
    NEAREST,
    NORMAL,
    PAPER,
    TOOL,
    WALL,
    is_tool,
    target_styles,
)
from htcp_jax.viewer.normal_glyphs import NO_GLYPHS, NormalGlyphs
from htcp_jax.viewer.viewpoints import ShownBodies, View, flat_side

DEPTH = LinearSegmentedColormap.from_list("wall", WALL)
SMALLEST_M = 0.1  # smallest extent of a view: that of a single point
LEVELS = 32  # of depth: markers of one colour are drawn in a third of the time
PLACE = {"left": 0.045, "right": 0.985, "bottom": 0.065, "top": 0.925, "wspace": 0.03, "hspace": 0.16}


def draw_plan(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    plans: Plans,
    row: int = 0,
    title: str = "",
    obstruction: Obstruction | None = None,
    fixtures: surface.WorldGeometry = surface.NOTHING,
    normals: NormalGlyphs = NO_GLYPHS,
) -> Figure:
    """Draw a plan.

    Args:
        robot: The robot, with the scenario's tool.
        workpiece: The workpiece.
        scenario: The scenario.
        plans: Plans, one of which is of the scenario.
        row: The row of that plan.
        title: The title of the figure.
        obstruction: The colliding body at the failed target, drawn in red; None if there is none.
        fixtures: The other obstacles.
        normals: Glyphs of the path's normals, if the task refers to them.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    figure = Figure(figsize=(14, 9.6), dpi=120, facecolor=PAPER)  # a layout engine would draw it three times
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=INK, fontsize=16, fontweight="bold", x=0.015, ha="left")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.4, 1), width_ratios=(1.12, 1), **PLACE)
    T = np.asarray(scenario.T_world_workpiece)
    cloud = workpiece.shown @ T[:3, :3].T + T[:3, 3]
    x_start = np.asarray(scenario.x_start)[None]
    view = _draw_scene(figure, grid, robot, cloud, plans, row, x_start, obstruction, fixtures)
    motion = motion_summary.summarise_motion(plans, int(scenario.on_path), row)
    for axes in figure.axes:
        axes.add_collection(LineCollection(view.flat(normals), colors=NORMAL, linewidths=0.7, zorder=4))
        _mark_dwells(axes, view.flat(plans.target[row]), motion)
    colliding_body = obstruction.description if obstruction is not None else ""
    below = figure.add_subplot(grid[1, :])
    _draw_motion(below, motion)
    _draw_clearance(below, plans, row, float(scenario.margin_m), colliding_body)
    return figure


def _draw_scene(
    figure: Figure,
    grid: GridSpec,
    robot: Robot,
    cloud: Float[np.ndarray, "P 3"],
    plans: Plans,
    row: int,
    x_start: Float[np.ndarray, "1 N"],
    obstruction: Obstruction | None = None,
    fixtures: surface.WorldGeometry = surface.NOTHING,
) -> View:
    """Draw two views from the same side, of everything and of the workpiece, and return that side."""
    shown = shown_targets(plans, row)
    x = plans.x[row, shown] if shown else x_start
    arm = arms_at(robot, x)
    view = flat_side(
        cloud, plans.target[row], ShownBodies(arm.p, arm.q, np.asarray(robot.capsule_radius), is_tool(robot))
    )
    for column, heading in enumerate((_pose_heading(shown), "Inside")):
        axes = figure.add_subplot(grid[0, column])
        _draw_wall(axes, view, cloud)
        _draw_fixtures(axes, view, fixtures)
        _draw_arm(axes, view, robot, arm)
        _draw_targets(axes, view, plans, row)
        if obstruction is not None and obstruction.collides:
            _draw_obstruction(axes, view, robot, obstruction)
        _set_limits(axes, view.flat(cloud) if column else None)
        _heading(axes, heading)
    return view


def draw_cell(
    robot: Robot,
    cloud: Float[np.ndarray, "P 3"],
    x_start: Float[np.ndarray, "1 N"],
    plans: Plans,
    title: str,
    fixtures: surface.WorldGeometry = surface.NOTHING,
) -> Figure:
    """Draw the arm in the workpiece cut open, and the other obstacles.

    Args:
        robot: The robot, with the scenario's tool.
        cloud: Points of the workpiece, world [m].
        x_start: The configuration to draw if no target is tracked [rad or m].
        plans: Plans; the first one is drawn.
        title: The title of the figure.
        fixtures: The other obstacles.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    figure = Figure(figsize=(14, 5.6), dpi=120, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=INK, fontsize=16, fontweight="bold", x=0.015, ha="left")
    grid = figure.add_gridspec(1, 2, width_ratios=(1.12, 1))
    _draw_scene(figure, grid, robot, cloud, plans, 0, x_start, fixtures=fixtures)
    return figure


def shown_targets(plans: Plans, row: int) -> list[int]:
    """Targets whose configurations are drawn: the first, the middle and the last of the tracked ones."""
    tracked = np.flatnonzero(plans.tracked[row])
    return sorted({int(tracked[i]) for i in (0, tracked.size // 2, -1)}) if tracked.size else []


def _draw_wall(axes: Axes, view: View, cloud: Float[np.ndarray, "P 3"]) -> None:
    """Draw the far half of the cloud, lighter with depth; the cut itself is darkest."""
    depth = cloud @ view.near
    cut = (depth.max() + depth.min()) / 2
    behind = np.flatnonzero(depth <= cut)
    behind = behind[np.argsort(depth[behind])]
    flat = view.flat(cloud[behind])
    look = {"linestyle": "", "marker": "o", "markersize": np.sqrt(1.2), "markeredgewidth": 0, "rasterized": True}
    for level, part in enumerate(np.array_split(flat, LEVELS)):
        share = 1 - level / (LEVELS - 1)
        axes.plot(*part.T, color=DEPTH(share), zorder=1 + level * 1e-3, **look)


def _draw_fixtures(axes: Axes, view: View, fixtures: surface.WorldGeometry) -> None:
    """Draw the fixtures, transparent, the farthest first."""
    triangles, clouds = fixtures
    if len(clouds.points):
        flat = view.flat(clouds.points)
        axes.scatter(*flat.T, color=to_rgba(FIXTURE, 0.25), s=1.2, linewidths=0, rasterized=True, zorder=1.5)
    if not len(triangles):
        return
    order = np.argsort(triangles.mean(axis=1) @ view.near)
    flat = view.flat(triangles[order].reshape(-1, 3)).reshape(-1, 3, 2)
    look = {"facecolors": to_rgba(FIXTURE, 0.25), "edgecolors": to_rgba(FIXTURE, 0.12), "linewidths": 0.3}
    axes.add_collection(PolyCollection(flat, rasterized=True, zorder=1.5, **look))


def _draw_arm(axes: Axes, view: View, robot: Robot, arm: kinematics.ArmShape) -> None:
    """Draw the capsules at several configurations: the last one solid, with its bare tip; the others as shadows."""
    p, q, radius = arm.p, arm.q, np.asarray(robot.capsule_radius)
    colours = np.where(is_tool(robot), TOOL, LINKS)
    for pose in range(len(p)):
        solid = pose == len(p) - 1
        order = np.argsort((p + q)[pose] @ view.near)
        bodies = PolyCollection(
            [stadium(view.flat(p[pose, k]), view.flat(q[pose, k]), radius[k]) for k in order],
            facecolors=[to_rgba(colour, 0.78 if solid else 0.05) for colour in colours[order]],
            edgecolors=PAPER if solid else [to_rgba(colour, 0.35) for colour in colours[order]],
            linewidths=0.8,
            zorder=3 if solid else 2,
        )
        axes.add_collection(bodies)
    axes.plot(*view.flat(np.stack([arm.tip[-1], arm.tcp[-1]])).T, color=TOOL, linewidth=2.5, zorder=3)


def _draw_obstruction(axes: Axes, view: View, robot: Robot, found: Obstruction) -> None:
    """Draw the colliding body as it would be at the failed target, and its contact point on the wall."""
    arm, k = arms_at(robot, found.x[None]), robot.capsule_names.index(found.body)
    outline = stadium(view.flat(arm.p[0, k]), view.flat(arm.q[0, k]), float(robot.capsule_radius[k]))
    body = PolyCollection([outline], facecolors=[to_rgba(FAILED, 0.12)], edgecolors=FAILED, linewidths=1.2, zorder=4)
    body.set_linestyle("--")
    axes.add_collection(body)
    axes.scatter(*view.flat(found.point[None]).T, s=90, marker="+", color=FAILED, linewidths=1.6, zorder=6)


def stadium(p: Float[np.ndarray, "2"], q: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "64 2"]:
    """Outline of a projected capsule: two half circles and two lines.

    Args:
        p: One end of the projected axis [m].
        q: The other end [m].
        radius: The capsule's radius [m].
    """
    along = np.arctan2(*(q - p)[::-1])
    half = np.linspace(-np.pi / 2, np.pi / 2, 32)
    angles = along + np.concatenate([half, half + np.pi])
    centres = np.repeat([q, p], 32, axis=0)
    return centres + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _draw_targets(axes: Axes, view: View, plans: Plans, row: int) -> None:
    status = plans.status[row]
    flat = view.flat(plans.target[row])
    axes.plot(*flat.T, color=INK, linewidth=0.6, alpha=0.5, zorder=4)
    for style in target_styles(status):
        look = {"color": style.colour, "s": style.size, "marker": style.marker, "linewidths": 0.6}
        axes.scatter(*flat[style.where].T, edgecolors=PAPER, zorder=5, **look)


def _mark_dwells(axes: Axes, flat: Float[np.ndarray, "T 2"], motion: motion_summary.MotionSummary) -> None:
    """Draw squares about the targets at which the arm changes its configuration."""
    look = {"s": 90, "marker": "s", "facecolors": "none", "edgecolors": DWELL, "linewidths": 1.6}
    axes.scatter(*flat[list(motion.dwells)].T, zorder=6, **look)


def _draw_motion(axes: Axes, motion: motion_summary.MotionSummary) -> None:
    """Draw lines at dwells, at the guaranteed clearance's minimum, and where the motion ends before the plan does."""
    for k, target in enumerate(motion.dwells):
        axes.axvline(target, label="dwell" if k == 0 else None, color=DWELL, linewidth=1.4, zorder=1)
    if motion.clearance_target is not None:
        _draw_line(axes, motion.clearance_target, f"minimum clearance: {motion.proven}", color=NEAREST, linestyle=":")
    if (end := motion.end).executable < end.tracked:
        _draw_line(
            axes, end.executable, f"target {end.executable}: {end.segment_status.message}", color=INK, linestyle="--"
        )


def _draw_line(axes: Axes, target: int, text: str, **look: str) -> None:
    """Draw a vertical line with text along it."""
    axes.axvline(target, linewidth=1.2, zorder=1, **look)
    how = {"rotation": 90, "ha": "right", "va": "center", "fontsize": 9, "color": look["color"], "zorder": 4}
    axes.annotate(text, (target, 0.5), (-2, 0), ("data", "axes fraction"), "offset points", **how)


def _set_limits(axes: Axes, around: Float[np.ndarray, "P 2"] | None) -> None:
    """Set equal scales, limits about everything or about the points `around`, and a scale bar."""
    axes.set_aspect("equal", anchor="NW")
    axes.axis("off")
    if around is None:
        axes.autoscale_view()
        axes.axhline(0, color=INK, linewidth=1, alpha=0.5, zorder=0)
    else:
        low, high = around.min(axis=0), around.max(axis=0)
        border = 0.05 * max((high - low).max(), SMALLEST_M)
        axes.set(xlim=(low[0] - border, high[0] + border), ylim=(low[1] - border, high[1] + border))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    length = 10.0 ** np.floor(np.log10((right - left) / 2))
    y = top - 0.03 * (top - bottom)
    axes.plot([left, left + length], [y, y], color=INK, linewidth=3, solid_capstyle="butt", zorder=6)
    style = {"textcoords": "offset points", "va": "center", "color": INK}
    axes.annotate(f"{length:g} m", (left + length, y), (5, 0), **style)


def _pose_heading(shown: list[int]) -> str:
    *shadows, last = shown or ["start"]
    where = "at its start" if last == "start" else f"at target {last}"
    others = f" (shadows: at {' and '.join(map(str, shadows))})" if shadows else ""
    return f"The arm {where}{others}, the workpiece cut open"


def _heading(axes: Axes, text: str) -> None:
    axes.set_title(text, color=INK, fontsize=12, loc="left")


def _draw_failure(axes: Axes, end: plan_arrays.Outcome, targets: int, colliding_body: str) -> None:
    """Draw a line at the failed target, its reason on the wider side, and grey over the targets not attempted."""
    axes.axvspan(end.failed + 0.5, targets, color="#eef0f2", linewidth=0, zorder=0)
    axes.axvline(end.failed, color=FAILED, linewidth=1.2, zorder=1)
    side, align = (-7, "right") if end.failed > targets / 2 else (7, "left")
    axes.annotate(
        "\n".join(filter(None, (f"target {end.failed}: {end.status.message}", colliding_body))),
        (end.failed, 1.0),
        (side, -7),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        color=FAILED,
        ha=align,
        va="top",
        zorder=4,
    )


def _draw_clearance(axes: Axes, plans: Plans, row: int, margin_m: float, colliding_body: str) -> None:
    """Draw clearance over target index, on a logarithmic scale, which resolves its minimum."""
    status, clearance_mm = plans.status[row], 1e3 * plans.clearance[row]
    index = np.arange(len(status))
    axes.plot(index, clearance_mm, color=INK, linewidth=0.8, alpha=0.5, zorder=2)
    axes.set_yscale("log")
    for style in target_styles(status):
        if style.where.any():
            look = {"color": style.colour, "s": 1.6 * style.size, "marker": style.marker, "linewidths": 0.6}
            points = index[style.where], clearance_mm[style.where]
            axes.scatter(*points, label=style.name, edgecolors=PAPER, zorder=3, **look)
    if margin_m > 0:
        style = {"color": INK, "linewidth": 0.9, "linestyle": "--", "zorder": 1}
        axes.axhline(1e3 * margin_m, label="required margin", **style)
    if (end := plans.outcome(row)).failed is not None:
        _draw_failure(axes, end, len(status), colliding_body)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlim(-1, len(status))
    axes.set_xlabel("target", color=INK)
    axes.grid(axis="y", color="#dfe3e6", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower left", frameon=False, ncols=6, bbox_to_anchor=(0.24, 1.0), borderaxespad=0.2)
    _heading(axes, "Clearance along the path [mm]")
