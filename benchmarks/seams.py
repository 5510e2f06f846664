"""Picture of the seams of the generated duct: a side view, and a view from its inlet.

python benchmarks/seams.py OUT.png
"""

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from htcp_jax.io.parts.duct_seams import seam
from htcp_jax.model.duct import STATIONS, surface
from htcp_jax.report.charts.style import INK, new_figure
from htcp_jax.spec import SEAMS
from htcp_jax.viewer.viewpoints import View

COLOURS = "#22303c", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#c8102e", "#332288"
WALL = "#d9cfba"
NOTE = "On the left from the side, inlet in front; on the right from the inlet, z up. Dots: where a seam begins."
ASIDE_RAD, ABOVE_RAD = np.radians((25.0, 25.0))  # of the side view


def main() -> None:
    """Draw the seams, and save the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    draw().savefig(parser.parse_args().out, dpi=110)


def draw() -> Figure:
    """Draw the wall as a net of lines, and every seam with its first point."""
    figure = new_figure(4.6, "The seams of the generated duct", NOTE)
    views = turned(ASIDE_RAD, ABOVE_RAD), turned(np.pi / 2, 0.0)
    for axes, view in zip(figure.subplots(1, 2, width_ratios=(2.1, 1)), views, strict=True):
        for line in wall():
            axes.plot(*view.flat(line).T, color=WALL, linewidth=0.5)
        for name, colour in zip(SEAMS, COLOURS, strict=True):
            axes.plot(*view.flat(seam(name)).T, color=colour, linewidth=1.8, marker="o", markevery=[0], label=name)
        axes.set_aspect("equal")
        axes.set_axis_off()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=8, frameon=False, labelcolor=INK)
    return figure


def turned(aside: float, above: float) -> View:
    """View from the right side of the duct, with its inlet on the left.

    It is rotated by `aside` towards the inlet and by `above` upwards [rad].
    """
    right = np.array([np.cos(aside), -np.sin(aside), 0.0])
    level = np.array([-np.sin(aside), -np.cos(aside), 0.0])
    z = np.array([0.0, 0.0, 1.0])
    return View(right, np.cos(above) * z - np.sin(above) * level, np.cos(above) * level + np.sin(above) * z)


def wall() -> list[Float[np.ndarray, "n 3"]]:
    """Lines around and along the wall [m]."""
    around, along = np.linspace(0.0, 2 * np.pi, 181), np.linspace(*STATIONS[[0, -1], 0], 97)
    rings = [surface(np.full_like(around, x), around) for x in along[::4]]
    return rings + [surface(along, np.full_like(along, angle)) for angle in around[:-1:5]]


if __name__ == "__main__":
    main()
