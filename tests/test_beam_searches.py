"""Searches of the beam: each on its own, from the configurations at its next target, until it ends."""

from dataclasses import replace

import numpy as np
import pytest

from htcp_jax.motion.step_functions import State
from htcp_jax.planning.beam.searches import NONE, Members, Searches
from htcp_jax.planning.beam.tree import BeamTree
from htcp_jax.settings import Settings
from htcp_jax.status import Status

FEW = replace(Settings(), min_beam_width=2, self_motions=3, self_motion_rounds=2, beam_width=8, beam_separation_rad=0.1)


def at(x) -> State:
    x = np.asarray(x, float).reshape(-1, 2)
    return State(x, clearance=x[:, 0], residual=x[:, 1], tcp=np.zeros((len(x), 3)))


def begun(targets, settings=FEW, has_self_motions=True) -> Searches:
    """Start a search for each of these counts of targets, from one start."""
    searches = Searches(settings, BeamTree(2), has_self_motions)
    roots = searches.tree.plant(at(np.zeros((len(targets), 2))), -1)
    searches.begin(list(range(len(targets))), [count - 1 for count in targets], list(roots[:, None]))
    return searches


def extended(searches, counts) -> None:
    """Add that many distant configurations at each search's next target."""
    first = {int(s): int(node) for s, node in zip(*searches.pending, strict=True)}
    search = np.repeat(list(first), [counts[s] for s in first])
    parent = np.array([first[int(s)] for s in search], int)
    x = np.arange(2 * len(search)).reshape(-1, 2) + searches.tree.x[parent]
    node = searches.tree.grow(parent, at(x), searches.tree.target[parent] + 1)
    searches.columns.failure[list(first)] = Status.PATH_BLOCKED
    searches.store_extended(Members(search, node))


def test_a_search_that_has_ended_is_extended_and_moved_no_more():
    """Ended searches: neither extended nor spread.

    One reaches its last target, one continues, and one gets nothing from the start.
    """
    searches = begun([2, 4, 4])
    extended(searches, [3, 3, 0])
    assert searches.pop_ended() == [2] and searches.columns.status.tolist() == [NONE, NONE, Status.PATH_BLOCKED]
    extended(searches, [3, 3, None])
    assert searches.pop_ended() == [0]
    for held in (searches.pending, searches.beam):
        assert set(held.search.tolist()) == {1}
    assert not len(searches.origins()[0].node)
    assert searches.columns.target.tolist() == [1, 1, -1] and searches.tracked == 2
    assert len(searches.beam_of(0)) == 3 and searches.tree.target[searches.beam_of(0)].tolist() == [1, 1, 1]


def test_a_thin_beam_is_spread_once_and_goes_on_with_what_was_found_and_what_was_not():
    """Thin beam: spread once by self-motions, then extended even if these found nothing.

    The self-motions start from the configurations at the target; a search with a full beam has none.
    """
    searches = begun([4, 4])
    extended(searches, [1, 3])
    origins, number = searches.origins()
    assert origins.search.tolist() == [0, 0, 0] and number.tolist() == [0, 1, 2]
    assert (searches.tree.target[origins.node] == 0).all()
    searches.store_self_motions(origins, Members.none())
    assert searches.columns.target.tolist() == [0, 0] and np.bincount(searches.pending.search).tolist() == [1, 3]
    assert searches.columns.rounds.tolist() == [0, 0] and searches.columns.draws.tolist() == [1, 0]


def test_a_dead_end_is_moved_from_in_turn_until_the_rounds_are_over():
    """Dead end: self-motions from the beam's members in turn, until the rounds are over.

    Configurations found are extended in their turn, unless the beam already has them.
    """
    searches = begun([4])
    extended(searches, [4])
    beam = searches.beam.node.tolist()
    extended(searches, [0])
    origins, _ = searches.origins()
    assert origins.node.tolist() == beam[:3]
    new = searches.tree.x[beam[0]] + np.array([[0.01, 0.0], [0.5, 0.0]])  # one that is known, one that is not
    found = searches.tree.grow(origins.node[:2], at(new), 0, by_self_motion=True, dwells=1)
    searches.store_self_motions(origins, Members(np.zeros(2, int), found))
    assert searches.pending.node.tolist() == [found[1]] and searches.beam.node.tolist() == [*beam, found[1]]
    extended(searches, [0])
    origins, _ = searches.origins()
    assert origins.node.tolist() == [beam[3], found[1], beam[0]]  # continued after the last round
    assert searches.columns.status.tolist() == [NONE]
    searches.store_self_motions(origins, Members.none())
    assert searches.columns.status.tolist() == [Status.PATH_BLOCKED] and searches.pop_ended() == [0]


def test_a_search_backwards_ends_at_its_last_target_or_when_it_is_stopped():
    searches = begun([3])
    extended(searches, [2])
    roots = searches.tree.plant(at([[0.0, 0.0], [1.0, 1.0]]), 5)
    for last in (3, 0):
        searches.begin([0], [last], [roots], [0], backwards=True)
    for target in (4, 3):
        search, parent = searches.pending.search[searches.pending.search > 0], searches.pending.node[-4:]
        x = searches.tree.x[parent] + 1.0
        node = searches.tree.grow(parent, at(x), target)
        searches.pending = searches.pending.of(np.array([False, True, True]))
        searches.store_extended(Members(search, node))
        searches.store_self_motions(Members.none(), Members.none())
    assert searches.columns.target.tolist() == [0, 3, 3] and searches.columns.work.tolist()[1:] == [4, 4]
    searches.stop(np.array([False, True, True]))
    assert searches.columns.status.tolist() == [NONE, NONE, Status.RECOVERY_EXHAUSTED]  # the first had arrived
    assert searches.pop_ended() == [1, 2]


@pytest.mark.parametrize("last", [False, True])
def test_without_a_null_space_there_are_no_self_motions(last):
    searches = begun([4], has_self_motions=False)
    extended(searches, [1])
    assert searches.columns.target.tolist() == [0] and not len(searches.origins()[0].node)
    extended(searches, [int(last)])
    assert (searches.columns.status[0] == NONE) == last


def test_forgotten_configurations_change_nothing_of_what_searches_hold():
    searches = begun([4000, 4000, 2])
    while not searches.tree.is_overgrown:
        extended(searches, [8, 5, 8])
        searches.pop_ended()
    before = [searches.tree.x[rows] for rows in (searches.beam.node, searches.pending.node, searches.beam_of(2))]
    count = len(searches.tree)
    searches.prune()
    assert len(searches.tree) < count
    now = [searches.tree.x[rows] for rows in (searches.beam.node, searches.pending.node, searches.beam_of(2))]
    for one, other in zip(before, now, strict=True):
        np.testing.assert_array_equal(one, other)
    extended(searches, [8, 5, None])
    assert searches.tree.target[searches.beam.node].min() > 100
