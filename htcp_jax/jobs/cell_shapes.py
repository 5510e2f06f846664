"""Shapes and clouds of a cell, with the link that carries each, and the links that each is not tested against.

Objects that do not move are obstacles. Objects that a moving link carries become bodies of the arm: capsules around
their convex hulls. If the part moves, planning is done in the frame of the part. The objects of the workshop move in
this frame, so they are bodies, too.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import load_cell, parts
from htcp_jax.io.robots import AttachedBody, attach
from htcp_jax.model import Fixture, Robot, fixture
from htcp_jax.model import robot as robots
from htcp_jax.spec import CellConfig, CloudConfig, ObstacleKind, tool, with_arrays
from htcp_jax.types import Triple

BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


class Carried(NamedTuple):
    """Frame that carries a fixture: the world or a link; and the links that the fixture is not tested against."""

    frame: robots.ArmFrame
    excluded: tuple[int, ...]  # indices of these links

    @property
    def T(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the frame in its link's frame, or in the world [m]."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = np.array(self.frame.columns).T, self.frame.origin_m
        return T

    @property
    def moves(self) -> bool:
        """True if the frame is on a moving link."""
        return self.frame.link >= 0


class StandingCell(NamedTuple):
    """The shapes and clouds of a cell that do not move, and the exclusions of all of them."""

    shapes: tuple[Fixture, ...]
    clouds: tuple[tuple[CloudConfig, Float[np.ndarray, "4 4"]], ...]  # clouds with their poses in the world [m]
    excluded: Mapping[str, tuple[int, ...]]  # links that a shape or cloud is not tested against, by its name


def standing_cell(cell: CellConfig, robot: Robot) -> StandingCell:
    """Load the shapes and clouds of a cell that do not move.

    Raises:
        InputError: If a file cannot be read, if a pose is given without a model, or if `fixtures` has an unknown name.
    """
    carried = _carriers(cell, robot)
    clouds = [(each, _carrier(robot, carried, name_of(each))) for each in cell.clouds]
    return StandingCell(
        tuple(
            shape if own.frame == robots.WORLD else _placed(shape, own.T)
            for shape, own in _with_carriers(cell, robot, carried)
            if not own.moves
        ),
        tuple((each, own.T @ tool.pose(each.base_m, each.base_rpy_rad)) for each, own in clouds if not own.moves),
        {name: own.excluded for name, own in carried.items()},
    )


def with_carried(robot: Robot, cell: CellConfig) -> Robot:
    """Return the robot with additional bodies: the shapes and clouds of the cell that its links carry.

    Raises:
        InputError: If `fixtures` has an unknown name, or if a carried object is not a box or a mesh.
    """
    if not (cell.is_carried or robot.part_moves):
        return robot
    carried = _carriers(cell, robot)
    bodies = [
        AttachedBody(shape.name, _points(shape, own.T), own.frame.link, own.excluded)
        for shape, own in _with_carriers(cell, robot, carried)
        if own.moves
    ]
    for cloud in cell.clouds:
        if (own := _carrier(robot, carried, name := name_of(cloud))).moves:
            if not len(triangles := parts.load_geometry(cloud.cloud, cloud.unit).triangles):
                raise InputError(f"fixture {name!r} is a cloud of points; only a box or a mesh can move with a link")
            T = own.T @ tool.pose(cloud.base_m, cloud.base_rpy_rad)
            points = _moved(triangles.reshape(-1, 3), T)
            bodies.append(AttachedBody(name, points, own.frame.link, own.excluded))
    return attach(robot, bodies) if bodies else robot


def name_of(cloud: CloudConfig) -> str:
    """Return the name of a cloud: the stem of its file."""
    return Path(cloud.cloud).stem


def _shapes(cell: CellConfig, moved: bool) -> tuple[Fixture, ...]:
    """Load the shapes of the cell's model; apply the job's `moved`, `shift_m` and `rpy_rad` if `moved` is True."""
    if cell.model is None:
        for key in ("moved", "shift_m", "rpy_rad"):
            if getattr(cell, key) != getattr(CellConfig(), key):
                raise InputError(f"cell.{key} is set, but cell.model is missing; set cell.model, too")
        return ()
    if not moved:
        return load_cell(cell.model)
    return load_cell(cell.model, moved=cell.moved, shift_m=cell.shift_m, rpy_rad=cell.rpy_rad)


def _carriers(cell: CellConfig, robot: Robot) -> dict[str, Carried]:
    """Return the carriers of the shapes and clouds in `cell.fixtures`, by name."""
    found: dict[str, Carried] = {}
    if cell.fixtures:
        known = sorted({*(shape.name for shape in _shapes(cell, moved=False)), *map(name_of, cell.clouds)})
    for k, each in enumerate(cell.fixtures):
        if each.name not in known:
            raise InputError(f"cell.fixtures.{k}: no fixture {each.name!r}; valid: {', '.join(known) or 'none'}")
        if each.name in found:
            raise InputError(f"cell.fixtures.{k}: {each.name!r} is listed twice")
        try:
            frame, *others = (robots.carrier_of(robot, name) for name in (each.parent, *each.exclude))
        except InputError as error:
            raise InputError(f"cell.fixtures.{k}: {error}") from None
        found[each.name] = Carried(frame, tuple(dict.fromkeys(other.link for other in others)))
    return found


def _carrier(robot: Robot, carried: Mapping[str, Carried], name: str) -> Carried:
    return carried.get(name, Carried(robot.world, ()))


def _with_carriers(cell: CellConfig, robot: Robot, carried: Mapping[str, Carried]) -> list[tuple[Fixture, Carried]]:
    """Load the shapes of the cell's model with their carriers.

    A shape fixed in the world has the pose from the job, any other shape the pose from the model's file.
    """
    shapes = _shapes(cell, moved=True)
    drawn = _shapes(cell, moved=False) if cell.is_carried else shapes
    owns = [_carrier(robot, carried, shape.name) for shape in shapes]
    return [
        (shape if own.frame == robot.world else other, own)
        for shape, other, own in zip(shapes, drawn, owns, strict=True)
    ]


def _placed(shape: Fixture, T: Float[np.ndarray, "4 4"]) -> Fixture:
    """Return a shape moved by the transform T [m]."""
    if shape.kind == "mesh":
        return shape._replace(triangles=_moved(shape.triangles, T))
    return shape._replace(T_world=T @ shape.T_world)


def _points(shape: Fixture, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "P 3"]:
    """Return the corners of a box or a mesh, moved by the transform T [m]."""
    if shape.kind not in ("box", "mesh"):
        raise InputError(f"fixture {shape.name!r} is a {shape.kind}; only a box or a mesh can move with a link")
    own = _placed(shape, T)
    return own.triangles.reshape(-1, 3) if shape.kind == "mesh" else _moved(BOX * own.size, own.T_world)


def _moved(points: Float[np.ndarray, "*n 3"], T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "*n 3"]:
    return points @ T[:3, :3].T + T[:3, 3]


def shapes_in_world(kind: ObstacleKind) -> tuple[Fixture, ...]:
    """Return the shapes of an obstacle at their poses in the world; () if its kind defines none.

    Raises:
        InputError: If a shape is not one of MuJoCo's primitives. The message names the kind.
    """
    found = []
    for shape in with_arrays(kind).shapes():
        wanted = fixture.PRIMITIVES.get(shape.type)
        size = tuple(float(value) for value in np.ravel(shape.size_m))
        if wanted is None or len(size) != wanted:
            valid = ", ".join(f"{name} with {count} sizes" for name, count in fixture.PRIMITIVES.items())
            raise InputError(f"{kind.name}: a shape of type {shape.type!r} has {len(size)} sizes; valid: {valid}")
        T = tool.pose(_triple(shape.position_m), _triple(shape.rpy_rad))
        found.append(Fixture(kind.name, shape.type, T, np.array([*size, 0.0, 0.0, 0.0])[:3], np.empty((0, 3, 3))))
    return tuple(found)


def _triple(values: Sequence[float]) -> Triple:
    return tuple(float(value) for value in np.ravel(values))
