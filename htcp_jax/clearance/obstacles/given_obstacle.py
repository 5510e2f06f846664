"""Obstacles of kinds that other packages define (`ObstacleKind`): a body's distance, computed from that of points.

The nearest point of a body's axis is found by a search along the axis. For a convex obstacle this is a golden section
search, as the distance is a convex function along a line. For other obstacles the distance d_i is measured at the ends
of PIECES equal intervals of length h. A point's distance changes by no more than the point moves. On an interval the
distance is therefore at least (d_i + d_i+1 - h) / 2 (Piyavskii, An algorithm for finding the absolute extremum of a
function, 1972). The smallest of these bounds is the free radius. The distance itself is refined about the smallest
measured value.

Bodies that are fixed in the world are not checked, nor are bodies of links on the root, such as the first link,
that touch the obstacle at x = 0, for example the arm's pedestal. See docs/add-an-obstacle.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle, Obstacles, bodies_at
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario
from htcp_jax.numerics import safe_norm
from htcp_jax.pytree import register_pytree
from htcp_jax.spec import ObstacleKind, Template, numbers_of, template_of
from htcp_jax.types import Bool, Float, Scalar, Vector3

PIECES, SECTIONS = 128, 48  # intervals of an axis, if the obstacle is not convex; steps of the golden section search
GOLDEN = (np.sqrt(5) - 1) / 2


@register_pytree
@dataclass(frozen=True)
class GivenObstacle(Obstacle):
    """An obstacle of an `ObstacleKind`; its parameters are the scenario's `obstacle_numbers` from index `first` on."""

    template: Template = field(metadata={"static": True})
    first: int = field(metadata={"static": True})

    @property
    def names(self) -> tuple[str, ...]:  # type: ignore[override]  # names are never set
        """The kind's name, as a tuple."""
        return (self.template.kind.name,)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with the obstacle."""
        return self._measured(robot, where, bodies)[0]

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[jax.Array, "K"]:
        """Return a lower bound on the distance of every body [m]."""
        return self._measured(robot, where, bodies)[1]

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the kind's name, for messages."""
        return f"the obstacle {self.template.kind.name!r}"

    def _measured(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes
    ) -> tuple[Contacts, Float[jax.Array, "K"]]:
        numbers: Float[jax.Array, "P"] = where.obstacle_numbers  # type: ignore[attr-defined]  # as `Scenario` has them
        own = self.template.with_numbers(numbers[self.first : self.first + self.template.size])
        radius = robot.capsule_radius
        point, distance, least = jax.vmap(lambda p, q: _nearest(own, p, q))(bodies.p, bodies.q)
        normal = jax.vmap(jax.grad(lambda point: own.distance(point).reshape(())))(point)
        length = safe_norm(normal)[:, None]
        normal = jnp.where(length > 1e-9, normal / jnp.maximum(length, 1e-9), jnp.array([0.0, 0.0, 1.0]))
        is_checked = self._checked_bodies(own, robot, where)
        far = jnp.where(is_checked, 0.0, jnp.inf)
        return Contacts(distance - radius + far, point, normal, radius, distance <= 0), least - radius + far

    def _checked_bodies(self, own: ObstacleKind, robot: Robot, where: HasWorkpiecePose) -> Bool[jax.Array, "K"]:
        """Return True for bodies that are checked against the obstacle."""
        links, attached = jnp.asarray(robot.capsule_link), np.isin(np.arange(len(robot.capsule_link)), robot.attached)
        may_stand = jnp.isin(links, jnp.array(robot.root_links)) & ~attached
        drawn = bodies_at(robot, where, jnp.zeros(robot.dof))
        at_zero = jax.vmap(lambda p, q: _nearest(own, p, q)[1])(drawn.p, drawn.q)
        return (links >= 0) & (~may_stand | (at_zero > robot.capsule_radius))


def _nearest(own: ObstacleKind, p: Vector3, q: Vector3) -> tuple[Vector3, Scalar, Scalar]:
    """Return the point of the axis p q nearest to an obstacle, its distance [m], and the axis's free radius [m]."""

    def at(t: Scalar) -> Scalar:
        return jnp.asarray(own.distance(p + t * (q - p)), float).reshape(())

    def section(_, ends):
        low, high = ends
        a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        left = at(a) < at(b)
        return jnp.where(left, low, a), jnp.where(left, b, high)

    low, high = jnp.zeros(()), jnp.ones(())
    bound: Scalar | float = jnp.inf
    if not own.convex:
        t = jnp.linspace(0.0, 1.0, PIECES + 1)
        d = jax.vmap(at)(t)
        bound = jnp.min(d[:-1] + d[1:] - safe_norm(q - p) / PIECES) / 2
        best = t[jnp.argmin(d)]
        low, high = jnp.maximum(best - 1 / PIECES, 0.0), jnp.minimum(best + 1 / PIECES, 1.0)
    low, high = jax.lax.fori_loop(0, SECTIONS, section, (low, high))
    t = jnp.stack([jnp.zeros(()), 0.5 * (low + high), jnp.ones(())])
    d = jax.vmap(at)(t)
    best = jnp.argmin(d)
    return p + t[best] * (q - p), d[best], jnp.minimum(bound, d[best])


def given_obstacles(kinds: Sequence[ObstacleKind]) -> Obstacles:
    """Return the obstacles for some kinds.

    Their parameters, `numbers_of(kinds)`, must be in the scenarios' `obstacle_numbers`.
    """
    templates = [template_of(each) for each in kinds]
    first = np.cumsum([0, *(each.size for each in templates)]).tolist()
    return tuple(GivenObstacle(each, k) for each, k in zip(templates, first, strict=False))


def with_given(obstacles: Sequence[Obstacle | ObstacleKind], scenarios: Scenario) -> tuple[Obstacles, Scenario]:
    """Convert each `ObstacleKind` into an obstacle, and write the parameters into the stacked scenarios.

    Args:
        obstacles: Obstacles and kinds.
        scenarios: Stacked scenarios.

    Returns:
        The obstacles, and the scenarios with `obstacle_numbers`.

    Raises:
        InputError: If the scenarios have `obstacle_numbers` already.
    """
    kinds = [each for each in obstacles if isinstance(each, ObstacleKind)]
    others = tuple(each for each in obstacles if not isinstance(each, ObstacleKind))
    if not kinds:
        return others, scenarios
    if scenarios.obstacle_numbers is not None:
        raise InputError(
            "the scenarios already contain the obstacles of their job; add further ones to cell.obstacles of that job"
        )
    numbers = np.tile(numbers_of(kinds), (len(scenarios.number), 1))
    return (*others, *given_obstacles(kinds)), replace(scenarios, obstacle_numbers=numbers)
