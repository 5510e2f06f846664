"""Picture of a plan: the arm in the workpiece, and the clearance along the path.

The workpiece is its own mesh, or the points of a cloud. It is cut open where its walls would hide the path. The scene
is drawn from the side in orthographic projection, in which the outline of a capsule is two half circles and
two lines. Where the convex piece of a mesh is checked in place of a capsule, its outline is drawn. Drawing needs no
screen.
"""

import textwrap
from collections.abc import Sequence

import numpy as np
import scipy
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from matplotlib.transforms import ScaledTranslation

from htcp_jax.errors import mm_text
from htcp_jax.model import Robot, Scenario, Workpiece, kinematics, surface
from htcp_jax.motion import Plans
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Obstruction
from htcp_jax.runs import MotionSummary, summarise_motion
from htcp_jax.spec import ToolAxisRow
from htcp_jax.status import AT_HOME, Status
from htcp_jax.viewer import seam_marks
from htcp_jax.viewer.angle_strip import draw_angles
from htcp_jax.viewer.arm_pose import (
    ArmPose,
    arms_at,
    links_at,
    moved,
    pieces_at,
    roots_at,
    seen,
    shown_bodies,
    together,
)
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
    is_tool,
    target_styles,
)
from htcp_jax.viewer.normal_glyphs import NO_GLYPHS, NormalGlyphs
from htcp_jax.viewer.picture_part import Part
from htcp_jax.viewer.viewpoints import ShownScene, View, flat_side
from htcp_jax.viewer.workcell import shown_triangles

THINNEST_M = 1e-5  # half of the width at which a flat shape is drawn
SMALLEST_M = 0.1  # minimum extent of a view, for example of a single point
FONT_PT, LINE_LENGTH = 9.5, 90  # texts in the clearance plot: size, and maximum characters per line
LONGEST_TEXTS = 0.7  # largest share of the clearance plot's height for texts above the curve
CLOSE = 0.03  # lines closer than this share of all targets have their texts left of the first line
AXIS_PT, TILT = 22.0, 0.5  # axes of a view: length of one across the view; how far down one towards the eye points
ALONG, BELOW_PT = 0.9, (0.0, -12.0)  # an axis with this component towards the eye, or away, is a symbol; its name
TRIAD_AT = 0.4, -0.42  # origin of the axes, from the view's lower left corner [inches]
BEHIND = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.75, "pad": 1}  # background of a text over a curve
LEGEND = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 6, "borderaxespad": 0.2, "frameon": False}
PLACE = {"left": 0.045, "right": 0.985, "bottom": 0.065, "top": 0.915, "wspace": 0.03, "hspace": 0.25}


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
    angles: tuple[Sequence[tuple[slice, ToolAxisRow]], Float[np.ndarray, "T 3"]] | None = None,
    seams: Sequence[str] = (),
) -> Figure:
    """Draw a plan: the arm in the workpiece in two views, and the clearance along the path.

    Args:
        robot: The robot, with the scenario's tool.
        workpiece: The workpiece.
        scenario: The scenario.
        plans: The plans, one of which is drawn.
        row: The row of `plans` with the scenario's plan.
        title: The title of the figure.
        obstruction: The colliding body at the failed target, drawn in red; None if there is none.
        fixtures: The other obstacles.
        normals: Glyphs of the path's normals, if the task refers to them.
        angles: Arguments of `draw_angles`: rows with tool angles, and the angles [degrees]; None: not drawn.
        seams: Names of several seams.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    ratios = (1.4, 1) if angles is None else (1.4, 1, 0.5)
    figure = Figure(
        figsize=(14, 4 * sum(ratios)), dpi=120, facecolor=PAPER
    )  # a layout engine would draw it three times
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=INK, fontsize=16, fontweight="bold", x=0.015, y=0.985, ha="left")
    grid = figure.add_gridspec(len(ratios), 2, height_ratios=ratios, width_ratios=(1.12, 1), **PLACE)
    T = np.asarray(scenario.T_world_workpiece)
    part = Part(workpiece.shown, shown_triangles(workpiece)).moved(T)
    begin = plans.start[row] if plans.status[row, 0] in AT_HOME else np.asarray(scenario.x_start)
    x_start = (obstruction.x if _is_attempt(plans, row, obstruction) else begin)[None]
    drawn = _draw_scene(figure, grid, robot, part, plans, row, x_start, obstruction, fixtures, seams)
    motion = summarise_motion(plans, int(scenario.on_path), row)
    for axes, (view, T) in zip(figure.axes, drawn, strict=True):
        axes.add_collection(LineCollection(view.flat(moved(normals, T)), colors=NORMAL, linewidths=0.7, zorder=4))
        _mark_dwells(axes, view.flat(moved(plans.target[row], T)), motion)
    colliding_body = obstruction.description if obstruction is not None else ""
    below = figure.add_subplot(grid[1, :])
    draw_clearance(below, plans, row, scenario)
    seam_marks.draw_begins(below, plans, seams)
    _draw_events(below, motion, plans.outcome(row), plans.status.shape[1], colliding_body)
    below.legend(**LEGEND)
    if angles is not None:
        draw_angles(figure.add_subplot(grid[2, :]), *angles)
    return figure


def _draw_scene(
    figure: Figure,
    grid: GridSpec,
    robot: Robot,
    part: Part,
    plans: Plans,
    row: int,
    x_start: Float[np.ndarray, "1 N"],
    obstruction: Obstruction | None = None,
    fixtures: surface.WorldGeometry = surface.NOTHING,
    seams: Sequence[str] = (),
) -> list[tuple[View, Float[np.ndarray, "4 4"]]]:
    """Draw a view of all objects and a close view of the workpiece, with the names of several seams.

    If the part moves, the first view is relative to the world, with the part's pose at the last configuration. The
    second view is relative to the part.

    Returns:
        The side of each view, and the T_world_root with which the view is drawn.
    """
    shown = shown_targets(plans, row)
    x = plans.x[row, shown] if shown else x_start
    arm, roots = arms_at(robot, x), roots_at(robot, x)
    poses = [
        ArmPose(kinematics.ArmShape(*one), 0, T_root=T, links=links)
        for *one, T, links in zip(*arm, roots, links_at(robot, x), strict=True)
    ]
    drawn = []
    where = _begin_text(plans, row, obstruction) if not shown else f"at target {shown[-1]}"
    headings = _pose_heading(shown, robot.part_moves, where), "From the part" if robot.part_moves else "Close-up"
    pieces = pieces_at(robot, x)
    for column, heading in enumerate(headings):
        axes = figure.add_subplot(grid[0, column])
        frames = [seen(pose, from_part=bool(column)) for pose in poses]
        T, arm = frames[-1].T_root, together(frames)
        wall, targets, others = part.moved(T), moved(plans.target[row], T), fixtures.placed(T)
        if column == 0 or robot.part_moves:  # else both views are the same
            bodies = shown_bodies(robot, frames[-1:])
            at = flat_side(ShownScene(wall.cloud, targets, bodies, wall.triangles, others.triangles, wall.axes))
        view = at.view
        wall.draw(axes, at)
        _draw_fixtures(axes, view, others)
        outlines = [_outlines(view, robot, *each) for each in zip(frames, pieces, strict=True)]
        _draw_arm(axes, view, robot, arm, outlines)
        _draw_targets(axes, view.flat(targets), plans, row)
        if column:
            seam_marks.draw_names(axes, view.flat(targets), plans, seams)
        if obstruction is not None and obstruction.collides:
            _draw_obstruction(axes, view, robot, obstruction, T)
        _set_limits(axes, view.flat(wall.cloud) if column else None, others.floor_m)
        draw_triad(axes, view)
        azimuth = round(np.degrees(np.arctan2(view.near[1], view.near[0])))
        cut = f",\n{at.cut_text}" if at.cut else ""  # one line would be wider than the panel
        _heading(axes, f"{heading}, seen from azimuth {azimuth}°{cut}")
        drawn.append((view, T))
    return drawn


def draw_cell(
    robot: Robot,
    cloud: Float[np.ndarray, "P 3"],
    x_start: Float[np.ndarray, "1 N"],
    plans: Plans,
    title: str,
    fixtures: surface.WorldGeometry,
    triangles: Float[np.ndarray, "M 3 3"],
    part_axes: Float[np.ndarray, "3 3"],
) -> Figure:
    """Draw the arm in the workpiece, and the other obstacles.

    Args:
        robot: The robot, with the scenario's tool.
        cloud: Points of the workpiece, world [m].
        x_start: The configuration to draw if no target is tracked [rad or m].
        plans: Plans; the first one is drawn.
        title: The title of the figure.
        fixtures: The other obstacles.
        triangles: Mesh of the workpiece, world [m]; none for a cloud.
        part_axes: Columns: axes of the workpiece's frame in the world.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    figure = Figure(figsize=(14, 5.6), dpi=120, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=INK, fontsize=16, fontweight="bold", x=0.015, ha="left")
    grid = figure.add_gridspec(1, 2, width_ratios=(1.12, 1))
    _draw_scene(figure, grid, robot, Part(cloud, triangles, part_axes), plans, 0, x_start, fixtures=fixtures)
    return figure


def shown_targets(plans: Plans, row: int) -> list[int]:
    """Return the targets whose configurations are drawn: the first, middle and last tracked ones."""
    tracked = np.flatnonzero(plans.tracked[row])
    return sorted({int(tracked[i]) for i in (0, tracked.size // 2, -1)}) if tracked.size else []


def _draw_fixtures(axes: Axes, view: View, fixtures: surface.WorldGeometry) -> None:
    """Draw the other obstacles, transparent, the farthest first."""
    triangles, clouds, _ = fixtures
    if len(clouds.points):
        flat = view.flat(clouds.points)
        axes.scatter(*flat.T, color=to_rgba(FIXTURE, 0.25), s=1.2, linewidths=0, rasterized=True, zorder=1.5)
    if not len(triangles):
        return
    order = np.argsort(triangles.mean(axis=1) @ view.near)
    flat = view.flat(triangles[order].reshape(-1, 3)).reshape(-1, 3, 2)
    look = {"facecolors": to_rgba(FIXTURE, 0.25), "edgecolors": to_rgba(FIXTURE, 0.12), "linewidths": 0.3}
    axes.add_collection(PolyCollection(flat, rasterized=True, zorder=1.5, **look))


def _outlines(
    view: View, robot: Robot, pose: ArmPose, pieces: dict[int, tuple[Float[np.ndarray, "_ 3"], float]]
) -> list[Float[np.ndarray, "_ 2"]]:
    """Return the outline of each body: of its convex piece if that is checked, else of its capsule."""
    arm, radius = pose.arm, np.asarray(robot.capsule_radius)
    found = [stadium(view.flat(p), view.flat(q), r) for p, q, r in zip(arm.p, arm.q, radius, strict=True)]
    for k, (vertices, thickness) in pieces.items():
        found[k] = rounded_outline(view.flat(moved(vertices, pose.T_root)), thickness)
    return found


def rounded_outline(points: Float[np.ndarray, "V 2"], radius: float) -> Float[np.ndarray, "W 2"]:
    """Return the outline of the convex hull of projected points [m], thickened by a radius [m]."""
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = max(radius, THINNEST_M) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    around = (points[:, None] + circle).reshape(-1, 2)
    return around[scipy.spatial.ConvexHull(around).vertices]


def _draw_arm(
    axes: Axes, view: View, robot: Robot, arm: kinematics.ArmShape, outlines: list[list[Float[np.ndarray, "_ 2"]]]
) -> None:
    """Draw the arm at several configurations: the last one solid and with its bare tip, the others as shadows."""
    p, q = arm.p, arm.q
    colours = np.where(is_tool(robot), TOOL, LINKS)
    for pose in range(len(p)):
        solid = pose == len(p) - 1
        order = np.argsort((p + q)[pose] @ view.near)
        bodies = PolyCollection(
            [outlines[pose][k] for k in order],
            facecolors=[to_rgba(colour, 0.78 if solid else 0.05) for colour in colours[order]],
            edgecolors=PAPER if solid else [to_rgba(colour, 0.35) for colour in colours[order]],
            linewidths=0.8,
            zorder=3 if solid else 2,
        )
        axes.add_collection(bodies)
    axes.plot(*view.flat(np.stack([arm.tip[-1], arm.tcp[-1]])).T, color=TOOL, linewidth=2.5, zorder=3)


def _draw_obstruction(axes: Axes, view: View, robot: Robot, found: Obstruction, T: Float[np.ndarray, "4 4"]) -> None:
    """Draw the colliding body at the failed target, and its contact point.

    Args:
        axes: The axes.
        view: The view.
        robot: The robot.
        found: The colliding body.
        T: T_world_root with which the view is drawn.
    """
    x, k = found.x[None], robot.capsule_names.index(found.body)
    arm = kinematics.ArmShape(*(moved(part[0], T) for part in arms_at(robot, x)))
    outline = _outlines(view, robot, ArmPose(arm, 0, T_root=T), pieces_at(robot, x)[0])[k]
    body = PolyCollection([outline], facecolors=[to_rgba(FAILED, 0.12)], edgecolors=FAILED, linewidths=1.2, zorder=4)
    body.set_linestyle("--")
    axes.add_collection(body)
    axes.scatter(*view.flat(moved(found.point[None], T)).T, s=90, marker="+", color=FAILED, linewidths=1.6, zorder=6)


def stadium(p: Float[np.ndarray, "2"], q: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "64 2"]:
    """Return the outline of a projected capsule: two half circles and two lines.

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


def _draw_targets(axes: Axes, flat: Float[np.ndarray, "T 2"], plans: Plans, row: int) -> None:
    seam_marks.draw_lines(axes, flat, plans)
    for style in target_styles(plans.status[row]):
        look = {"color": style.colour, "s": style.size, "marker": style.marker, "linewidths": 0.6}
        axes.scatter(*flat[style.where].T, edgecolors=PAPER, zorder=5, **look)


def _mark_dwells(axes: Axes, flat: Float[np.ndarray, "T 2"], motion: MotionSummary) -> None:
    """Draw squares around the targets at which the arm dwells, that is, changes its configuration."""
    look = {"s": 90, "marker": "s", "facecolors": "none", "edgecolors": DWELL, "linewidths": 1.6}
    axes.scatter(*flat[list(motion.dwells)].T, zorder=6, **look)


def _draw_events(
    axes: Axes, motion: MotionSummary, end: plan_arrays.Outcome, targets: int, colliding_body: str
) -> None:
    """Draw vertical lines at dwells, the failed target, the end of the executable motion, and its minimum clearance.

    Each line except a dwell's has a text, on its side with more space; texts are stacked downwards, above the curve.
    The range of targets that were not attempted is grey.
    """
    for k, target in enumerate(motion.dwells):
        axes.axvline(target, label="dwell" if k == 0 else None, color=DWELL, linewidth=1.4, zorder=1)
    events = []
    if end.failed is not None:
        axes.axvspan(end.failed + 0.5, targets, color="#eef0f2", linewidth=0, zorder=0)
        events.append((end.failed, f"target {end.failed}: {end.status.message}\n{colliding_body}", FAILED, "-"))
    if end.executable < end.tracked:
        events.append((end.executable, f"target {end.executable}: {end.segment_status.message}", INK, "--"))
    if motion.clearance_target is not None:
        events.append((motion.clearance_target, f"minimum clearance: {motion.proven}", NEAREST, ":"))
    below = 4
    ends = [target for target, *_ in events]
    for target, text, colour, line in events:
        axes.axvline(target, linewidth=1.2, zorder=1, color=colour, linestyle=line)
        left = target > targets / 2
        look = {"color": colour, "ha": "right" if left else "left", "va": "top", "fontsize": FONT_PT, "zorder": 4}
        lines = [part for each in text.splitlines() for part in textwrap.wrap(each, LINE_LENGTH)]
        beside = min(each for each in ends if each >= target - CLOSE * targets) if left else target
        place, offset = (beside, 1.0), (-7 if left else 7, -below)
        axes.annotate("\n".join(lines), place, offset, ("data", "axes fraction"), "offset points", **look, bbox=BEHIND)
        below += 1.4 * FONT_PT * len(lines)
    height_pt = 72 * axes.get_position().height * axes.figure.get_figheight()
    low, high = axes.get_ylim()
    _set_logarithmic(axes, low, low * (high / low) ** (1 / (1 - min(below / height_pt, LONGEST_TEXTS))))


def _set_logarithmic(axes: Axes, low: float, high: float) -> None:
    """Set the range of a logarithmic y axis, with plain numbers."""
    axes.set_ylim(low, high)
    digits = (1, 2, 3, 4, 6, 8) if high / low < 10 else (1, 2, 5) if high / low < 1e5 else (1,)
    axes.yaxis.set_major_locator(LogLocator(subs=digits, numticks=99))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _set_limits(axes: Axes, around: Float[np.ndarray, "P 2"] | None, floor_m: float | None) -> None:
    """Set equal scales and limits, and draw the floor and a scale bar.

    Args:
        axes: The axes of a view.
        around: Points that the limits include; None: all objects.
        floor_m: Height of the floor [m]; None: a line below all objects of a view of all objects, at most at 0.
    """
    axes.set_aspect("equal", anchor="NW")
    axes.axis("off")
    if around is None:
        axes.autoscale_view()
        floor_m = min(0.0, axes.dataLim.y0) if floor_m is None else floor_m
    if floor_m is not None:
        axes.axhline(floor_m, color=INK, linewidth=1, alpha=0.5, zorder=0)
    if around is not None:
        low, high = around.min(axis=0), around.max(axis=0)
        largest = max((high - low).max(), SMALLEST_M)
        border = np.maximum(0.05 * largest, 0.25 * largest - (high - low) / 2)  # a line is shown with its surroundings
        axes.set(xlim=(low[0] - border[0], high[0] + border[0]), ylim=(low[1] - border[1], high[1] + border[1]))
    draw_scale(axes, above=True)


def draw_scale(axes: Axes, above: bool = False) -> None:
    """Draw a scale bar in a strip below all objects; its length is 1, 2 or 5 times a power of ten [m].

    Args:
        axes: The axes, with their limits set.
        above: True to draw the strip above all objects.
    """
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    longest = (right - left) / 2
    power = 10.0 ** np.floor(np.log10(longest))
    length = power * max(step for step in (1, 2, 5) if step * power <= longest or step == 1)
    strip = 0.08 * (top - bottom)
    y = top + strip / 2 if above else bottom - strip / 2
    behind = {"xmin": 0, "xmax": 1, "color": PAPER, "linewidth": 0, "zorder": 5.9}
    axes.axhspan(*((top, top + strip) if above else (bottom - strip, bottom)), **behind)
    axes.plot([left, left + length], [y, y], color=INK, linewidth=3, solid_capstyle="butt", zorder=6)
    style = {"textcoords": "offset points", "va": "center", "color": INK, "zorder": 6}
    axes.annotate(f"{length:g} m", (left + length, y), (5, 0), **style)
    axes.set_xlim(left, right)
    axes.set_ylim(*((bottom, top + strip) if above else (bottom - strip, top)))


def draw_triad(axes: Axes, view: View) -> None:
    """Draw the axes x, y and z below the view, as seen from slightly above: one towards the eye points down.

    An axis along the line of sight is a circle: with a dot if it points towards the eye, with a cross if away from it.
    """
    origin = axes.transAxes + ScaledTranslation(*TRIAD_AT, axes.figure.dpi_scale_trans)
    arrow = {"arrowstyle": "<-", "color": INK, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    look = {"ha": "center", "va": "center", "color": INK, "fontsize": FONT_PT, "zorder": 6.5}
    for name, axis in zip("xyz", np.eye(3), strict=True):
        near = view.near @ axis
        if abs(near) > ALONG:
            for marker, size in (("o", 10), ("." if near > 0 else "x", 5)):
                symbol = {"marker": marker, "markersize": size, "color": INK, "markerfacecolor": PAPER, "zorder": 6.6}
                axes.plot(0, 0, transform=origin, clip_on=False, **symbol)
            axes.annotate(name, (0, 0), BELOW_PT, origin, "offset points", **look)
            continue
        end = AXIS_PT * np.array([view.right @ axis, view.up @ axis - TILT * near])
        axes.annotate(name, (0, 0), tuple(end), origin, "offset points", arrowprops=arrow, **look)


def _is_attempt(plans: Plans, row: int, obstruction: Obstruction | None) -> bool:
    """Return True if the obstruction is that of a random configuration that was tried as a start."""
    return obstruction is not None and bool(plans.status[row, 0] == Status.NO_START)


def _begin_text(plans: Plans, row: int, obstruction: Obstruction | None) -> str:
    """Return where the arm is drawn if no target is tracked."""
    if _is_attempt(plans, row, obstruction):
        return "in the clearest attempt at target 0"
    if plans.status[row, 0] == Status.NO_START:
        return "without a start"
    return "at home" if plans.status[row, 0] in AT_HOME else "at its start"


def _pose_heading(shown: list[int], part_moves: bool, where: str) -> str:
    shadows = f" (shadows: at {' and '.join(map(str, shown[:-1]))})" if len(shown) > 1 else ""
    return f"The arm {where}{shadows}{', in the world' if part_moves else ''}"


def _heading(axes: Axes, text: str) -> None:
    axes.set_title(text, color=INK, fontsize=11, loc="left", y=1.0)  # without y, matplotlib measures all ticks twice


def draw_clearance(axes: Axes, plans: Plans, row: int, scenario: Scenario) -> None:
    """Draw the clearance over the target index, on a logarithmic scale to resolve small values.

    The heading has the smallest guaranteed clearance on segments off the path, if it is known.

    Args:
        axes: The axes.
        plans: The plans.
        row: Row of the plan.
        scenario: The scenario.
    """
    status, clearance_mm = plans.status[row], 1e3 * plans.clearance[row]
    index = np.arange(len(status))
    line = seam_marks.without_air_moves(clearance_mm, plans)
    axes.plot(*line, color=INK, linewidth=0.8, alpha=0.5, zorder=2)
    axes.set_yscale("log")
    for style in target_styles(status):
        if style.where.any():
            look = {"color": style.colour, "s": 1.6 * style.size, "marker": style.marker, "linewidths": 0.6}
            points = index[style.where], clearance_mm[style.where]
            axes.scatter(*points, label=style.name, edgecolors=PAPER, zorder=3, **look)
    style = {"color": INK, "linewidth": 0.9, "linestyle": "--", "zorder": 1, "label": "required margin"}
    if scenario.seam_margins_m is not None:
        axes.step(index, 1e3 * scenario.seam_margins_m[:, 0], where="mid", **style)
    elif scenario.margin_m > 0:
        axes.axhline(1e3 * float(scenario.margin_m), **style)
    _set_logarithmic(axes, *axes.get_ylim())
    axes.set_xlim(-1, len(status))
    axes.set_xlabel("target", color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="y", color="#dfe3e6", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    off_path = plans.executable[row] & ((index <= int(scenario.on_path)) | plans.begins_seam)
    known = plans.segment_clearance[row, off_path & np.isfinite(plans.segment_clearance[row])]
    air = f"; off the path at least {mm_text(known.min())}" if known.size else ""
    _heading(axes, f"Clearance along the path [mm], logarithmic{air}")
