"""Data of the paper's tables 1 and 2, and the grids of their scenarios.

Source: Y. Sun, W. Zhao, C. Liu, "Hybrid Task Constrained Planner for Robot Manipulator in Confined Environment".
The paper's times were measured with MATLAB 2022 on a 2.5 GHz Intel Core i9.
"""

from collections.abc import Sequence
from typing import NamedTuple

SOURCE = "Sun, Zhao, Liu: Hybrid Task Constrained Planner for Robot Manipulator in Confined Environment"
MACHINE = "MATLAB 2022, 2.5 GHz Intel Core i9"
TARGETS = 105  # number of targets in a scenario
START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)  # centre of the grid of starts; assumed, as the paper does not specify it


class PaperRow(NamedTuple):
    """Row of one of the paper's tables: one method's results."""

    success_percent: float
    step_s: float  # "computation time": mean time per step
    tcp_distance_mm: float
    safe_distance_mm: float  # "closest distance between robot and obstacle"; the paper does not specify minimum or mean


class PaperTable(NamedTuple):
    """One of the paper's tables: a sweep by six methods, which have their names in this package."""

    number: int
    sweep: str
    scenarios: int
    grid: tuple[str, ...]  # names of the varied parameters, as in `groups.Part.axes`
    offsets: tuple[float, ...]  # values of every axis, relative to its middle value
    rows: dict[str, PaperRow]

    @property
    def source(self) -> str:
        """Reference to the table in the paper, as text."""
        return f"{SOURCE}, table {self.number}"

    def is_axis(self, values: Sequence[float]) -> bool:
        """Return True if the values, relative to their middle value, are equal to `offsets`."""
        middle = sum(values) / len(values)
        offsets = [value - middle for value in values]
        return len(values) == len(self.offsets) and all(
            abs(a - b) < 1e-6 for a, b in zip(offsets, self.offsets, strict=True)
        )

    def tracked(self, method: str) -> int:
        """Return the number of tracked targets that corresponds to a method's success percentage."""
        return round(self.rows[method].success_percent / 100 * self.scenarios * TARGETS)


ROBOT = PaperTable(
    1,
    "125 start configurations",
    125,
    ("start_joint3_rad", "start_joint4_rad", "start_joint5_rad"),
    (-0.2, -0.1, 0.0, 0.1, 0.2),
    {
        "baseline": PaperRow(66.95, 0.4281, 0.4474, 0.1561),
        "cspace-sample": PaperRow(68.50, 0.4697, 0.4510, 0.1572),
        "nspace-sample": PaperRow(70.85, 0.5266, 0.4494, 0.4622),
        "nspace-sqp": PaperRow(99.84, 0.4142, 0.4450, 0.6309),
        "nspace-ip": PaperRow(99.71, 0.4145, 0.4385, 0.7028),
        "nspace-cmaes": PaperRow(100.0, 0.6745, 0.4533, 0.8200),
    },
)

WORKPIECE = PaperTable(
    2,
    "49 workpiece poses",
    49,
    ("rotation_y_rad", "rotation_z_rad"),
    (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3),
    {
        "baseline": PaperRow(39.16, 0.2789, 0.4831, 12.0973),
        "cspace-sample": PaperRow(49.93, 0.5740, 0.4668, 4.6684),
        "nspace-sample": PaperRow(50.11, 1.1377, 0.4557, 4.1437),
        "nspace-sqp": PaperRow(70.73, 0.8583, 0.4207, 4.3668),
        "nspace-ip": PaperRow(76.87, 1.0240, 0.3986, 1.7241),
        "nspace-cmaes": PaperRow(62.22, 3.2577, 0.4287, 7.5280),
    },
)
