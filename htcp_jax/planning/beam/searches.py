"""State of the beam searches: progress, configurations and next steps.

One row per search in every column, so that thousands run together.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.device import tables
from htcp_jax.motion import front, posture_tree
from htcp_jax.settings import Settings

NONE = -1  # no status yet; no earlier search


class Members(NamedTuple):
    """Tree rows of searches, grouped by search; the order within a group is the search's."""

    search: Int[np.ndarray, "n"]
    node: Int[np.ndarray, "n"]

    @classmethod
    def none(cls) -> "Members":
        """Return no rows."""
        return cls(np.zeros(0, int), np.zeros(0, int))

    def of(self, which: Bool[np.ndarray, "searches"]) -> "Members":
        """Select the rows of some searches."""
        return tables.gather(self, which[self.search])

    def and_(self, others: "Members") -> "Members":
        """Append the rows of `others` to those of the same searches."""
        both = tables.concatenate([self, others])
        return tables.gather(both, np.argsort(both.search, kind="stable"))


class Columns(NamedTuple):
    """Columns of integers with one row per search."""

    scenario: Int[np.ndarray, "n"]
    target: Int[np.ndarray, "n"]  # of its beam
    targets: Int[np.ndarray, "n"]  # number of targets
    earlier: Int[np.ndarray, "n"]  # the search before, if this one begins at other configurations; or NONE
    rounds: Int[np.ndarray, "n"]  # rounds of self-motions at this target
    draws: Int[np.ndarray, "n"]  # rounds of self-motions in total
    failure: Int[np.ndarray, "n"]  # its Status if no more configurations reach the next target
    status: Int[np.ndarray, "n"]  # Status of a search that ended before the last target; or NONE


class Searches:
    """All searches of one tree.

    `front` is the beam of each search at its target, `unfed` the part of it that is still to be extended to the next
    target, and `arrived` the configurations already there while the search spreads.
    """

    def __init__(self, settings: Settings, tree: posture_tree.BeamTree, can_walk: bool):
        self._settings, self._can_walk, self.tree = settings, can_walk, tree
        self.columns = Columns(*(np.zeros(0, int) for _ in Columns._fields))
        self.going = np.zeros(0, bool)
        self.front = self.unfed = self.arrived = Members.none()
        self._ended: dict[int, np.ndarray] = {}  # the beams of searches that have ended

    def begin(self, scenario: list[int], targets: list[int], roots: list[np.ndarray], earlier: int = NONE) -> None:
        """Add searches, each of one scenario, all at one target.

        Args:
            scenario: Row of the scenario, per search.
            targets: Number of its targets, per search.
            roots: One or more tree rows to begin from, per search.
            earlier: The search before, if these begin at other configurations; or NONE.
        """
        count, draws = len(scenario), 0 if earlier == NONE else self.columns.draws[earlier]
        first = len(self.going)
        held = Members(np.repeat(np.arange(first, first + count), [len(own) for own in roots]), np.concatenate(roots))
        target = self.tree.target[[own[0] for own in roots]]
        new = Columns(
            np.array(scenario),
            target,
            np.array(targets),
            *(np.full(count, value) for value in (earlier, 0, draws, NONE, NONE)),
        )
        self.columns, self.going = tables.concatenate([self.columns, new]), np.append(self.going, np.ones(count, bool))
        self.front, self.unfed = tables.concatenate([self.front, held]), tables.concatenate([self.unfed, held])

    def has(self, members: Members) -> Bool[np.ndarray, "searches"]:
        """Return True for searches that have any of these."""
        return self._count(members) > 0

    def chain(self, search: int) -> list[int]:
        """Return the search and those before it, latest first."""
        earlier = int(self.columns.earlier[search])
        return [search, *(self.chain(earlier) if earlier != NONE else [])]

    @property
    def tracked(self) -> int:
        """Number of targets reached by running searches that are their scenario's first."""
        return int((self.columns.target[self.going & (self.columns.earlier == NONE)] + 1).sum())

    def front_of(self, search: int) -> list[int]:
        """Return the beam of a search when it ended, the best first."""
        rows = self._ended[search]
        return rows[front.best_first(self.tree.nodes(rows))].tolist()

    def take_fed(self, arrived: Members) -> None:
        """Store the results of extending all `unfed` rows."""
        now, count, fed = self.columns, self._count(arrived), self.has(self.unfed)
        last = now.target == now.targets - 2
        thin = fed & (count > 0) & (count < self._settings.thin_front) & ~last & self._can_walk
        self.unfed, self.arrived = Members.none(), arrived.of(thin)
        self._lose(fed & (count == 0) & ((now.target < 0) | (not self._can_walk) | self._walked_enough))
        self._go_on(arrived.of(~thin))

    def walkers(self) -> tuple[Members, Int[np.ndarray, "n"]]:
        """Return the configurations from which to move in the null space, and the self-motions' numbers.

        One row per self-motion; numbers count from 0 in every search.
        """
        resting = self.going & ~self._done & ~self.has(self.unfed)
        among = self.arrived.and_(self.front.of(resting & ~self.has(self.arrived)))
        rows, count = np.flatnonzero(resting), self._count(among)
        walker = np.arange(self._settings.walks)
        first, nth = np.cumsum(count) - count, walker + len(walker) * self.columns.rounds[rows][:, None]
        node = among.node[first[rows][:, None] + nth % count[rows][:, None]]
        return Members(np.repeat(rows, len(walker)), node.ravel()), np.tile(walker, len(rows))

    def take_walked(self, walkers: Members, found: Members) -> None:
        """Store the results of one round of self-motions."""
        walked, wide = self.has(walkers), self.has(self.arrived)
        self.columns.draws[walked] += 1
        arrived, self.arrived = self.arrived.and_(found.of(wide)), Members.none()
        self._go_on(arrived)
        stuck = walked & ~wide
        self.columns.rounds[stuck] += 1
        new = self._dispersed(found.of(stuck), known=self.front.of(stuck))
        self.front, self.unfed = self.front.and_(new), self.unfed.and_(new)
        self._lose(stuck & ~self.has(new) & self._walked_enough)

    def take_ended(self) -> list[int]:
        """Stop and return the searches that have ended, by success or failure."""
        ended = self.going & self._done
        held = self.front.of(ended)
        self.going &= ~ended
        self.front, self.unfed = self.front.of(self.going), self.unfed.of(self.going)
        searches = np.flatnonzero(ended).tolist()
        self._ended |= {search: held.node[held.search == search] for search in searches}
        return searches

    def forget(self, ended: list[int]) -> None:
        """Discard the beams of ended searches."""
        for search in ended:
            del self._ended[search]

    def prune(self) -> None:
        """Remove all configurations without descendants in a beam if the tree is overgrown."""
        if self.tree.is_overgrown:
            moved = self.tree.prune(np.concatenate([self.front.node, *self._ended.values()]))
            self.front = self.front._replace(node=moved[self.front.node])
            self.unfed = self.unfed._replace(node=moved[self.unfed.node])
            self._ended = {search: moved[rows] for search, rows in self._ended.items()}

    @property
    def _done(self) -> Bool[np.ndarray, "searches"]:
        return (self.columns.status != NONE) | (self.columns.target == self.columns.targets - 1)

    @property
    def _walked_enough(self) -> Bool[np.ndarray, "searches"]:
        return self.columns.rounds >= self._settings.walk_rounds

    def _count(self, members: Members) -> Int[np.ndarray, "searches"]:
        return np.bincount(members.search, minlength=len(self.going))

    def _lose(self, which: Bool[np.ndarray, "searches"]) -> None:
        self.columns.status[which] = self.columns.failure[which]

    def _go_on(self, arrived: Members) -> None:
        """Make the best of the configurations at the next target the new beams."""
        which = self.has(arrived)
        new = self._dispersed(arrived, most=self._settings.front)
        self.front, self.unfed = self.front.of(~which).and_(new), self.unfed.and_(new)
        self.columns.target[which] += 1
        self.columns.rounds[which] = 0

    def _dispersed(self, members: Members, most: int | None = None, known: Members | None = None) -> Members:
        """Return the best members that are far apart, and far from the known ones."""
        members = tables.gather(members, front.best_first(self.tree.nodes(members.node), members.search))
        most = len(members.node) if most is None else most
        where = None if known is None else (self.tree.x[known.node], known.search)
        x, apart = self.tree.x[members.node], self._settings.front_apart_rad
        return tables.gather(members, front.dispersed(x, members.search, most, apart, where))
