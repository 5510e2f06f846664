"""The postures that a roadmap keeps at one target: clear, on target, each connected to the start, and far apart."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float


@dataclass(slots=True, eq=False)
class Node:
    """A posture, and the way there from its parent. The nodes of a scenario are a tree; those that lead nowhere are
    forgotten with their last child."""

    x: Float[np.ndarray, "N"]
    clearance: float  # [m]
    residual: float  # [m]
    tcp: Float[np.ndarray, "3"]  # world [m]
    target: int
    parent: "Node | None" = None
    walked: Float[np.ndarray, "k N"] | None = None  # postures passed after the parent's; None where it was fed
    step_qps: int = 0
    dwells: int = field(default=0)  # changes of posture on the path so far
    cost: float = field(default=0.0)  # of the way so far, equation (3): the sum of |x_{t+1} - x_t|^2 [rad2]

    def __post_init__(self):
        if (parent := self.parent) is not None:
            steps = np.diff([parent.x, self.x] if self.walked is None else [parent.x, *self.walked], axis=0)
            self.dwells += parent.dwells
            self.cost = parent.cost + float((steps * steps).sum())

    def ancestors(self) -> "Iterator[Node]":
        """Itself, its parent, and so on."""
        node: Node | None = self
        while node is not None:
            yield node
            node = node.parent

    @property
    def root(self) -> "Node":
        """The first of its ancestors."""
        return list(self.ancestors())[-1]


def best_first(nodes: Iterable[Node]) -> list[Node]:
    """Fewest dwells first, then least cost; of equals the one found first."""
    return sorted(nodes, key=lambda node: (node.dwells, node.cost))


def dispersed(nodes: Sequence[Node], most: int, apart: float, known: Sequence[Node] = ()) -> list[Node]:
    """Up to `most` of the nodes, all further than `apart` [rad] from each other and from those known: of close ones the
    best, and where there are more than that, those that are far from each other (farthest-point selection)."""
    chosen: list[Node] = []
    near = [node.x for node in known]
    for node in best_first(nodes):
        if not near or np.min(np.linalg.norm(np.array(near) - node.x, axis=1)) >= apart:
            chosen.append(node)
            near.append(node.x)
    if len(chosen) <= most:
        return chosen
    return [chosen[k] for k in sorted(farthest_first(np.array([node.x for node in chosen]), 0, most, apart))]


def farthest_first(x: Float[np.ndarray, "n N"], first: int, most: int, apart: float) -> list[int]:
    """Up to `most` rows of x, from `first` on always the one farthest from those chosen; none nearer than `apart`."""
    kept, distance = [first], np.linalg.norm(x - x[first], axis=1)
    while len(kept) < most and distance.max() >= apart:
        kept.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(x - x[kept[-1]], axis=1))
    return kept
