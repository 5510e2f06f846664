"""The workpiece in the picture of a plan: its mesh, or the points of a cloud, darkest at the cut."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap

from htcp_jax.model import surface
from htcp_jax.viewer import arm_pose
from htcp_jax.viewer.colours import WALL
from htcp_jax.viewer.drawn_meshes import cut_triangles, normals_of
from htcp_jax.viewer.viewpoints import NO_TRIANGLES, Viewpoint, cut_depth

DEPTH = LinearSegmentedColormap.from_list("wall", WALL)
LEVELS = 32  # number of depth levels; drawing markers of one colour together is faster
SORTED = 25  # a triangle's edges are at most this part of the workpiece's extent, so that its depth can be sorted
SHADE = 0.35  # loss of brightness of a triangle that is seen from the side


class Part(NamedTuple):
    """Workpiece for a picture, world [m]."""

    cloud: Float[np.ndarray, "P 3"]
    triangles: Float[np.ndarray, "M 3 3"] = NO_TRIANGLES  # its mesh; none: the points are drawn
    axes: Float[np.ndarray, "3 3"] = np.eye(3)  # columns: axes of its frame

    def moved(self, T: Float[np.ndarray, "4 4"]) -> "Part":
        """Return the workpiece transformed by T [m]."""
        return Part(arm_pose.moved(self.cloud, T), arm_pose.moved(self.triangles, T), T[:3, :3] @ self.axes)

    def draw(self, axes: Axes, at: Viewpoint) -> None:
        """Draw what remains of the workpiece after a cut, the farthest first.

        Args:
            axes: The axes.
            at: The viewpoint, which is horizontal.
        """
        (self._draw_mesh if len(self.triangles) else self._draw_points)(axes, at)

    def _draw_points(self, axes: Axes, at: Viewpoint) -> None:
        view, depth = at.view, self.cloud @ at.view.near
        behind = np.flatnonzero(self.cloud @ at.axis.direction <= cut_depth(self.cloud, at))
        behind = behind[np.argsort(depth[behind])]
        flat = view.flat(self.cloud[behind])
        look = {"linestyle": "", "marker": "o", "markersize": np.sqrt(1.2), "markeredgewidth": 0, "rasterized": True}
        for level, part in enumerate(np.array_split(flat, LEVELS)):
            share = 1 - level / (LEVELS - 1)
            axes.plot(*part.T, color=DEPTH(share), zorder=1 + level * 1e-3, **look)

    def _draw_mesh(self, axes: Axes, at: Viewpoint) -> None:
        near, depth = at.view.near, self.cloud @ at.view.near
        kept = cut_triangles(self.triangles, at.axis.direction, cut_depth(self.cloud, at)) if at.cut else self.triangles
        kept = surface.pieces(kept, float(np.ptp(self.cloud, axis=0).max()) / SORTED, "picture")
        height = kept.mean(axis=1) @ near
        order = np.argsort(height)
        share = 1 - (height[order] - depth.min()) / max(np.ptp(height), 1e-9)
        colours = DEPTH(np.clip(share, 0, 1))
        colours[:, :3] *= 1 - SHADE * (1 - np.abs(normals_of(kept[order]) @ near))[:, None]
        flat = at.view.flat(kept[order])
        look = {"facecolors": colours, "edgecolors": colours, "linewidths": 0.4, "rasterized": True}
        axes.add_collection(PolyCollection(flat, zorder=1, **look))
