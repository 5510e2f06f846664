"""State of the beam searches: progress, configurations and next steps.

The state is a table with one row per search, so that thousands of searches run together.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.device import tables
from htcp_jax.motion import configurations
from htcp_jax.planning.beam.tree import BeamTree, best_first
from htcp_jax.settings import Settings
from htcp_jax.status import Status

NONE = -1  # value for "no status yet" and for "no earlier search"


class Members(NamedTuple):
    """Tree rows that belong to searches, grouped by search; the order within a search is preserved."""

    search: Int[np.ndarray, "n"]  # index of the search
    node: Int[np.ndarray, "n"]  # row in the tree

    @classmethod
    def none(cls) -> "Members":
        """Return an empty table."""
        return cls(np.zeros(0, int), np.zeros(0, int))

    def of(self, which: Bool[np.ndarray, "searches"]) -> "Members":
        """Return the rows of some searches."""
        return tables.gather(self, which[self.search])

    def appended(self, others: "Members") -> "Members":
        """Return these rows and `others`, grouped by search, with `others` last in each search."""
        both = tables.concatenate([self, others])
        return tables.gather(both, np.argsort(both.search, kind="stable"))


class SearchColumns(NamedTuple):
    """Columns of integers with one row per search."""

    scenario: Int[np.ndarray, "n"]
    target: Int[np.ndarray, "n"]  # target at which the beam is
    last: Int[np.ndarray, "n"]  # target at which the search ends with success
    step: Int[np.ndarray, "n"]  # 1 forwards, -1 backwards: the next target is target + step
    earlier: Int[np.ndarray, "n"]  # index of the search that this one continues; NONE for a first search
    rounds: Int[np.ndarray, "n"]  # number of rounds of self-motions at this target
    draws: Int[np.ndarray, "n"]  # number of rounds of self-motions in total
    work: Int[np.ndarray, "n"]  # number of extended configurations and self-motions so far
    width: Int[np.ndarray, "n"]  # factor on the settings' beam widths and rounds of self-motions
    failure: Int[np.ndarray, "n"]  # Status of the search if no more configurations reach the next target
    status: Int[np.ndarray, "n"]  # Status of a search that ended before its last target; else NONE
    root: Int[np.ndarray, "n"]  # target of the root of an ended search's best path; 0 for the start


class Searches:
    """All searches of one tree.

    `beam` has the beam of each search. `pending` has the configurations of the beam that are still to be extended
    to the next target. `arrived` has the configurations that have reached the next target while the search spreads.
    """

    def __init__(self, settings: Settings, tree: BeamTree, has_self_motions: bool):
        self._settings, self._has_self_motions, self.tree = settings, has_self_motions, tree
        self.columns = SearchColumns(*(np.zeros(0, int) for _ in SearchColumns._fields))
        self.going = np.zeros(0, bool)
        self.beam = self.pending = self.arrived = Members.none()
        self._ended: dict[int, np.ndarray] = {}  # search that has ended -> tree rows of its beam

    def begin(
        self,
        scenario: list[int],
        last: list[int],
        roots: list[Int[np.ndarray, "_"]],
        earlier: list[int] | None = None,
        backwards: bool | Bool[np.ndarray, "n"] = False,
        width: int = 1,
    ) -> list[int]:
        """Add one search per scenario, and return their indices.

        Args:
            scenario: Row of each search's scenario.
            last: Target at which each search ends with success.
            roots: Tree rows at one target from which each search begins, one or more.
            earlier: Index of the search that each new one continues; None for first searches.
            backwards: True to search from later targets to earlier ones.
            width: Factor on the settings' beam widths and rounds of self-motions.
        """
        if not scenario:
            return []
        first, before = len(self.going), np.full(len(scenario), NONE) if earlier is None else np.array(earlier)
        new = np.arange(first, first + len(scenario))
        held = Members(np.repeat(new, [len(own) for own in roots]), np.concatenate(roots))
        given = {
            "scenario": np.array(scenario),
            "target": self.tree.target[[own[0] for own in roots]],
            "last": np.array(last),
            "step": np.where(backwards, -1, 1),
            "earlier": before,
            "draws": 0 if earlier is None else self.columns.draws[before],
        }
        equal = {"rounds": 0, "work": 0, "width": width, "failure": NONE, "status": NONE, "root": NONE}
        columns = SearchColumns(**{name: np.zeros_like(new) + value for name, value in (given | equal).items()})
        self.columns = tables.concatenate([self.columns, columns])
        self.going = np.append(self.going, np.ones(len(new), bool))
        goes_on = np.append(np.zeros(first, bool), columns.target != columns.last)  # False: already at the last target
        self.beam = tables.concatenate([self.beam, held])
        self.pending = tables.concatenate([self.pending, held.of(goes_on)])
        return new.tolist()

    def has(self, members: Members) -> Bool[np.ndarray, "searches"]:
        """Return True for searches with at least one row in `members`."""
        return self._count(members) > 0

    def chain(self, search: int) -> list[int]:
        """Return the search, the search that it continues, and so on to the scenario's first search."""
        found = [search]
        while (earlier := int(self.columns.earlier[found[-1]])) != NONE:
            found.append(earlier)
        return found

    def forwards(self, search: int) -> list[int]:
        """Return the searches forwards in a search's chain: the farthest target first, of equal ones the older."""
        forwards = [one for one in self.chain(search)[::-1] if self.columns.step[one] > 0]
        return sorted(forwards, key=lambda one: -self.columns.target[one])

    @property
    def tracked(self) -> int:
        """Number of targets reached by running first searches of scenarios."""
        return int((self.columns.target[self.going & (self.columns.earlier == NONE)] + 1).sum())

    def beam_of(self, search: int) -> list[int]:
        """Return the tree rows in the beam of an ended search, the best first."""
        return self._ended[search].tolist()

    def store_extended(self, arrived: Members) -> None:
        """Store the results of extending all `pending` rows."""
        now, count, extended = self.columns, self._count(arrived), self.has(self.pending)
        now.work[:] += self._count(self.pending)
        last = now.target + now.step == now.last
        is_thin = (count > 0) & (count < self._settings.min_beam_width * now.width)
        thin = extended & is_thin & ~last & self._has_self_motions
        self.pending, self.arrived = Members.none(), arrived.of(thin)
        self._lose(extended & (count == 0) & ((now.target < 0) | (not self._has_self_motions) | self._rounds_spent))
        self._select_beams(arrived.of(~thin))

    def origins(self) -> tuple[Members, Int[np.ndarray, "n"]]:
        """Return the configurations from which self-motions start, one row each, and the self-motions' numbers.

        Numbers count from 0 in every search.
        """
        resting = self.going & ~self._done & ~self.has(self.pending)
        among = self.arrived.appended(self.beam.of(resting & ~self.has(self.arrived)))
        rows, count = np.flatnonzero(resting), self._count(among)
        motion_number = np.arange(self._settings.self_motions)
        first, nth = np.cumsum(count) - count, motion_number + len(motion_number) * self.columns.rounds[rows][:, None]
        node = among.node[first[rows][:, None] + nth % count[rows][:, None]]
        return Members(np.repeat(rows, len(motion_number)), node.ravel()), np.tile(motion_number, len(rows))

    def store_self_motions(self, origins: Members, found: Members) -> None:
        """Store the configurations found by one round of self-motions from `origins`."""
        moved, wide = self.has(origins), self.has(self.arrived)
        self.columns.draws[moved] += 1
        self.columns.work[:] += self._count(origins)
        arrived, self.arrived = self.arrived.appended(found.of(wide)), Members.none()
        self._select_beams(arrived)
        stuck = moved & ~wide
        self.columns.rounds[stuck] += 1
        new = self._dispersed(found.of(stuck), known=self.beam.of(stuck))
        self.beam, self.pending = self.beam.appended(new), self.pending.appended(new)
        self._lose(stuck & ~self.has(new) & self._rounds_spent)

    def stop(self, which: Bool[np.ndarray, "searches"]) -> None:
        """Mark unfinished searches as failed (RECOVERY_EXHAUSTED)."""
        self.columns.status[which & self.going & ~self._done] = Status.RECOVERY_EXHAUSTED

    def pop_ended(self) -> list[int]:
        """Remove searches that have ended, by success or failure, from the running ones; return their indices."""
        ended = self.going & self._done
        searches, held = np.flatnonzero(ended), self.beam.of(ended)
        self.going &= ~ended
        self.beam, self.pending = self.beam.of(self.going), self.pending.of(self.going)
        if len(searches):
            rows = held.node[best_first(self.tree.nodes(held.node), held.search)]
            first = np.searchsorted(held.search, searches)
            self._ended |= zip(searches.tolist(), np.split(rows, first[1:]), strict=True)
            self.columns.root[searches] = np.maximum(0, self.tree.target[self.tree.roots(rows[first])])
        return searches.tolist()

    def forget(self, ended: list[int]) -> None:
        """Discard the beams of ended searches."""
        for search in ended:
            del self._ended[search]

    def prune(self) -> None:
        """If the tree has grown enough, remove its configurations that have no descendants in a beam."""
        if self.tree.is_overgrown:
            moved = self.tree.prune(np.concatenate([self.beam.node, *self._ended.values()]))
            self.beam = self.beam._replace(node=moved[self.beam.node])
            self.pending = self.pending._replace(node=moved[self.pending.node])
            self._ended = {search: moved[rows] for search, rows in self._ended.items()}

    @property
    def _done(self) -> Bool[np.ndarray, "searches"]:
        return (self.columns.status != NONE) | (self.columns.target == self.columns.last)

    @property
    def _rounds_spent(self) -> Bool[np.ndarray, "searches"]:
        return self.columns.rounds >= self._settings.self_motion_rounds * self.columns.width

    def _count(self, members: Members) -> Int[np.ndarray, "searches"]:
        return np.bincount(members.search, minlength=len(self.going))

    def _lose(self, which: Bool[np.ndarray, "searches"]) -> None:
        self.columns.status[which] = self.columns.failure[which]

    def _select_beams(self, arrived: Members) -> None:
        """Make the best configurations of `arrived` the new beams, at the next target."""
        which = self.has(arrived)
        new = Members.none()
        for width in np.unique(self.columns.width[which]).tolist():
            own = arrived.of(self.columns.width == width)
            new = new.appended(self._dispersed(own, most=self._settings.beam_width * width))
        self.beam, self.pending = self.beam.of(~which).appended(new), self.pending.appended(new)
        self.columns.target[which] += self.columns.step[which]
        self.columns.rounds[which] = 0

    def _dispersed(self, members: Members, most: int | None = None, known: Members | None = None) -> Members:
        """Return the best members that are far from each other and from `known`."""
        members = tables.gather(members, best_first(self.tree.nodes(members.node), members.search))
        most = len(members.node) if most is None else most
        where = None if known is None else (self.tree.x[known.node], known.search)
        x, apart = self.tree.x[members.node], self._settings.beam_separation_rad
        return tables.gather(members, configurations.dispersed(x, members.search, most, apart, where))
