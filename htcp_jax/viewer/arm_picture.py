"""Picture of an imported arm in two views: its capsules over the shapes that they enclose, and its convex pieces.

Fitted capsules are coloured by their largest distance from the mesh. The convex pieces, to which distances are measured
where capsules are too near to decide, are drawn in a second row.

The capsules come from the arm's file, placed by MuJoCo's kinematics in the configuration nearest to zero within the
joint limits. Drawing needs no screen.
"""

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator
from scipy.spatial import ConvexHull

from htcp_jax.io import robots
from htcp_jax.viewer.colours import DWELL, INK, PAPER, WALL
from htcp_jax.viewer.picture import stadium

OWN, DRAWN = DWELL, WALL[1]  # colours of capsules from the arm's file, and of the shapes that capsules enclose
EXCESS = colormaps["plasma"]
SIDES = {"seen along y": [0, 2], "seen against x": [1, 2]}  # indices of the world axes drawn to the right and up
PIECE = INK  # colour of the convex pieces
LEGEND = {  # by colour
    DRAWN: "the mesh",
    OWN: "capsules of the model",
    EXCESS(0.5): "capsules about the mesh, for a first, fast test; coloured by their distance from the mesh",
    PIECE: "convex pieces, which decide where the capsules come too near",
}
WIDTH_IN, MOST_ROW_IN, ROOM_IN, TITLE_IN = 14, 10, 1.5, 0.5  # of the figure; of a row, and for its texts; of the title
AXES, AXIS_M = ("#c0392b", "#27ae60", "#2c5fd1"), 0.1  # colours of the TCP frame's axes, and their length


def draw_arm(arm: robots.ImportedArm, text: str, title: str) -> Figure:
    """Draw an imported arm in two views, in the configuration nearest to zero.

    Args:
        arm: The imported arm, with the shapes that its capsules enclose.
        text: Contents of the arm's MJCF file.
        title: The title of the figure.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    low, high = np.where(model.jnt_limited[:, None] > 0, model.jnt_range, [-np.inf, np.inf]).T
    data.qpos[:] = np.clip(0.0, low, high)
    for j, follower in arm.followers.items():  # masters first
        name, master = (robots.joint_name(arm.model, each) for each in (j, follower.master))
        data.joint(name).qpos[:] = follower.at(data.joint(master).qpos[0])
    mujoco.mj_kinematics(model, data)
    has_pieces = any(cover.hulls for cover in arm.covers.values())
    rows = 1 + has_pieces
    figure = Figure(figsize=(WIDTH_IN, MOST_ROW_IN * rows), dpi=110, facecolor=PAPER, layout="compressed")
    FigureCanvasAgg(figure)
    excess = [1e3 * each for cover in arm.covers.values() for each in cover.excesses.values()]
    scale = ScalarMappable(Normalize(0.0, max(excess, default=0.0) or 1.0), EXCESS)
    grid = figure.subplots(rows, len(SIDES), sharex="col", sharey=True, squeeze=False)
    for row, what in zip(grid, ("capsules", "convex pieces"), strict=False):
        for axes, (heading, flat) in zip(row, SIDES.items(), strict=True):
            _draw_side(axes, arm, model, data, flat, scale, pieces=what != "capsules")
            axes.set_title(f"{what},\n{heading}", color=INK, fontsize=12, loc="left")
    widths = [np.ptp(axes.get_xlim()) for axes in grid[0]]
    grid[0, 0].get_gridspec().set_width_ratios(widths)  # equal scales
    row_in = ROOM_IN + 0.8 * WIDTH_IN * np.ptp(grid[0, 0].get_ylim()) / sum(widths)
    height_in = TITLE_IN + rows * min(row_in, MOST_ROW_IN)
    figure.set_figheight(height_in)
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - TITLE_IN / height_in))
    figure.suptitle(title, color=INK, fontsize=15, fontweight="bold", x=0.015, y=1 - 0.15 / height_in, ha="left")
    step_m = max(np.diff(ticks)[0] for ticks in (grid[0, 0].get_xticks(), grid[0, 0].get_yticks()))
    for axis in (axis for axes in grid.flat for axis in (axes.xaxis, axes.yaxis)):
        axis.set_major_locator(MultipleLocator(step_m))
    has = {DRAWN: True, OWN: any(cover.own for cover in arm.covers.values()), EXCESS(0.5): bool(excess)}
    handles = [Patch(color=colour, label=text) for colour, text in LEGEND.items() if has.get(colour, has_pieces)]
    figure.legend(handles=handles, loc="outside lower left", frameon=False, fontsize=11, labelcolor=INK)
    if excess:
        bar = figure.colorbar(scale, ax=grid, shrink=0.6 / rows, pad=0.01)
        bar.set_label("largest distance of the capsule's surface from its mesh [mm]", color=INK)
        bar.outline.set_visible(False)
    return figure


def _draw_side(
    axes: Axes,
    arm: robots.ImportedArm,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    flat: list[int],
    scale: ScalarMappable,
    pieces: bool,
) -> None:
    """Draw the arm in one view, with its capsules, or with its convex pieces and the capsules that have none."""
    for b, cover in arm.covers.items():
        at = model.body(robots.body_name(arm.model, b)).id if b else 0
        R, t = data.xmat[at].reshape(3, 3), data.xpos[at]
        triangles = (np.concatenate([cover.enclosed, cover.drawn]) @ R.T + t)[..., flat]
        axes.add_collection(PolyCollection(triangles, facecolors=DRAWN, linewidths=0, rasterized=True, zorder=2))
        if pieces:
            hulls = [_outline((each.vertices @ R.T + t)[:, flat], each.radius) for each in cover.hulls.values()]
            look = {"facecolors": to_rgba(PIECE, 0.2), "edgecolors": PIECE, "linewidths": 1.0}
            axes.add_collection(PolyCollection(hulls, zorder=3, **look))
        fitted = {name: capsule for name, capsule in cover.fitted.items() if not pieces or name not in cover.hulls}
        colours = [scale.to_rgba(1e3 * cover.excesses[name]) for name in fitted]
        for shown, capsules in ((colours, fitted), ([OWN] * len(cover.own), cover.own)):
            moved = [(R @ capsule.p + t, R @ capsule.q + t, capsule.radius) for capsule in capsules.values()]
            outlines = [stadium(p[flat], q[flat], radius) for p, q, radius in moved]
            look = {"facecolors": [to_rgba(each, 0.12) for each in shown], "edgecolors": shown, "linewidths": 1.0}
            axes.add_collection(PolyCollection(outlines, zorder=3, **look))
    tcp = model.site("tcp").id
    for axis, colour in zip(data.site_xmat[tcp].reshape(3, 3).T, AXES, strict=True):
        ends = data.site_xpos[tcp] + np.outer([0, AXIS_M], axis)
        axes.plot(*ends[:, flat].T, color=colour, linewidth=2.5, zorder=5)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.tick_params(colors=INK, labelsize=9, labelleft=True, labelbottom=True)  # also of shared axes
    axes.set_xlabel(f"{'xyz'[flat[0]]} [m]", color=INK)
    axes.set_ylabel(f"{'xyz'[flat[1]]} [m]", color=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _outline(points: Float[np.ndarray, "V 2"], radius: float) -> Float[np.ndarray, "n 2"]:
    """Return the outline of a projected hull that is thickened by a radius [m]."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ball = max(radius, 1e-6) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    around = (points[:, None] + ball).reshape(-1, 2)
    return around[ConvexHull(around).vertices]
