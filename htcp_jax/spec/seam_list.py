"""Seams of a part: each has a path, a direction and its place in the order of work.

seams:
  - {name: rib, path: rib.csv}
  - {name: flange, path: flange.csv, closed: true, after: [rib]}
  - {name: holes, path: holes.csv, points: true, margin_m: 0.002, feed: 5mm/s}
"""

from collections import Counter
from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Annotated, Literal

from pydantic import Field, model_validator

from htcp_jax.errors import InputError
from htcp_jax.spec import strict_model
from htcp_jax.spec.feed import Feed
from htcp_jax.spec.given_kinds import Row as TaskRow

Direction = Literal["either", "forward", "backward"]
SeamName = Annotated[str, Field(min_length=1, max_length=60)]
Row = Annotated[int, Field(ge=0)]


class SeamConfig(strict_model.FileSection):
    """One seam: rows of a path's file, and when and in which direction the tool follows them."""

    name: SeamName
    path: str = Field(min_length=1)  # a seam of the generated duct, or a CSV file of x,y,z
    rows: tuple[Row, Row] | None = None  # first row of the path, counted from 0, and number of rows; None: all
    # direction of travel; backward: from the last row to the first; None: forward in a CAM system's file, else either
    direction: Direction | None = None
    closed: bool = False  # True: a closed curve, which may begin at any of its rows
    begins_at: Row | None = None  # row of a closed seam, counted from 0, at which it begins and ends; None: any
    points: bool = False  # True: each row is a seam of one target, such as a hole or a spot
    after: tuple[SeamName, ...] = ()  # seams that must be done before this one
    task: tuple[TaskRow, ...] = ()  # rows of the task on this seam; empty: the job's
    margin_m: float | None = Field(None, ge=0, le=1)  # required clearance on this seam; None: the job's
    feed: Feed | None = None  # feed rate of the TCP on this seam, with its unit; None: the job's

    @model_validator(mode="after")
    def _is_one_kind(self) -> "SeamConfig":
        if self.points and (self.closed or self.direction not in (None, "either")):
            key = "closed" if self.closed else "direction"
            raise InputError(f"seam {self.name!r} has points: true; its key {key} would have no effect, omit it")
        if self.begins_at is not None and not self.closed:
            raise InputError(f"seam {self.name!r}: begins_at is for a seam with closed: true")
        return self


def check_seams(seams: Sequence[SeamConfig]) -> None:
    """Check the names and the precedence of a part's seams.

    Raises:
        InputError: For a name that occurs twice, an unknown name in `after`, and seams that wait for each other.
    """
    names = [seam.name for seam in seams]
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"seams: the name {name!r} occurs {count} times; names must differ")
    before = {seam.name: seam.after for seam in seams}
    for seam in seams:
        for name in seam.after:
            if name not in before:
                raise InputError(f"seams: {seam.name!r} is after {name!r}, which is no seam; seams: {', '.join(names)}")
    try:
        TopologicalSorter(before).prepare()
    except CycleError as error:
        raise InputError(f"seams: the keys after form a circle: {' before '.join(error.args[1])}") from None
