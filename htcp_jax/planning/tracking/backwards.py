"""Planning backwards from a failed target to the first one.

Clear configurations are sampled at the failed target. Each is moved back from target to target, which gives a chain of
configurations. A chain replaces the previous results if all of its joint paths are clear, including the path from the
start to its first configuration. In each round, one call of a lane function advances all lanes in the same phase:

    draw    sample configurations at the failed target; each valid one begins a chain
    push    extend every chain by one target backwards; chains whose new configuration is not valid end
    check   test a chain that has reached the first target: the joint paths between its rows, and from the start
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.motion import step_functions
from htcp_jax.planning.tracking.lane_checks import LaneChecks
from htcp_jax.planning.tracking.lanes import CHECKING, DRAWING, PUSHING, Lanes
from htcp_jax.planning.tracking.record import Record
from htcp_jax.planning.tracking.stages import DRAW, PUSH, Recoveries
from htcp_jax.settings import Settings
from htcp_jax.status import Status

LOST = -6  # in place of a phase: the scenario has ended


@dataclass
class Chains:
    """Chains of one scenario, from the target reached so far to the failed target."""

    x: np.ndarray  # configurations (C, rows, N) of C chains [rad or m]
    rounds: int = 0  # number of rounds of random draws so far


class BackwardsRound(NamedTuple):
    """Result of a round of planning backwards; scenarios in neither `going` nor `found` have ended."""

    going: Lanes  # lanes that continue, in their next phases
    found: Lanes  # lanes at their target whose chain is recorded
    now: step_functions.State | None  # states of `found`; None if `found` is empty
    lost: int  # number of scenarios that have ended without success


class BackwardPlans:
    """The scenarios of one engine that are planned backwards."""

    def __init__(
        self,
        checks: LaneChecks,
        record: Record,
        recoveries: Recoveries,
        settings: Settings,
        starts: Float[np.ndarray, "S N"],
    ):
        self._checks, self._record, self._starts = checks, record, starts
        self._rounds = settings.restart_rounds if recoveries.replan_backwards else 0
        self._recovery = recoveries.backwards
        self._chains: dict[int, Chains] = {}

    def begin(self, lanes: Lanes) -> BackwardsRound:
        """Begin with lanes whose target failed; their scenarios end if the method does not plan backwards."""
        none = np.zeros((0, 1, lanes.x_ref.shape[1]))
        self._chains.update({scenario: Chains(none) for scenario in lanes.scenario.tolist()})
        return self._replanned(lanes, np.zeros(lanes.size, bool))

    def advance(self, lanes: Lanes, phase: int) -> BackwardsRound:
        """Advance lanes in one phase by one step."""
        if phase == CHECKING:
            return self._check(lanes)
        (self._draw if phase == DRAWING else self._push)(lanes)
        return self._replanned(lanes, np.zeros(lanes.size, bool))

    def _of(self, lanes: Lanes) -> list[Chains]:
        return [self._chains[scenario] for scenario in lanes.scenario.tolist()]

    def _draw(self, lanes: Lanes) -> None:
        """Sample configurations at the failed targets; each valid one begins a chain, the clearest first."""
        chains = self._of(lanes)
        drawn = self._checks.executor(DRAW, self._checks.inputs(lanes, np.array([each.rounds for each in chains])))
        count = drawn.x.shape[1]
        flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), drawn)
        good = self._checks.at_target(tables.gather(lanes, np.repeat(np.arange(lanes.size), count)), flat)
        for each, x, keep in zip(chains, drawn.x, good.reshape(-1, count), strict=True):
            each.x, each.rounds = x[keep][:, None], each.rounds + 1

    def _push(self, lanes: Lanes) -> None:
        """Extend all chains backwards by one target."""
        chains = self._of(lanes)
        owner = np.repeat(np.arange(lanes.size), [len(each.x) for each in chains])
        many = tables.gather(lanes, owner)
        length = np.array([each.x.shape[1] for each in chains], np.int32)
        many = many._replace(target=many.target - length[owner])
        here = self._checks.executor(PUSH, self._checks.inputs(many), np.concatenate([each.x[:, 0] for each in chains]))
        good = self._checks.at_target(many, here)
        for k, each in enumerate(chains):
            own = owner == k
            each.x = np.concatenate([here.x[own][:, None], each.x], axis=1)[good[own]]

    def _check(self, lanes: Lanes) -> BackwardsRound:
        """Record the first chain of every lane if all of its joint paths are clear, else discard the chain."""
        chains = self._of(lanes)
        rows = [each.x.shape[1] for each in chains]
        owner, end = np.repeat(np.arange(lanes.size), rows), np.cumsum(rows) - 1
        x = np.concatenate([each.x[0] for each in chains])
        many = self._rows(tables.gather(lanes, owner), x, end)
        blocked = np.bincount(owner, self._checks.path_clear(many, x, requested=True) == 0, lanes.size)
        clear = blocked == 0
        for each in chains:
            each.x = each.x[1:]
        if clear.any():
            own = clear[owner]
            now = self._checks.measured(tables.gather(many, own), x[own])
            self._write(tables.gather(many, own), now)
            end = np.cumsum(np.array(rows)[clear]) - 1
            return self._replanned(lanes, clear)._replace(
                found=tables.gather(tables.gather(many, own), end), now=tables.gather(now, end)
            )
        return self._replanned(lanes, clear)

    def _rows(self, many: Lanes, x: np.ndarray, end: np.ndarray) -> Lanes:
        """Return one lane per row of complete chains.

        Only the last row of a chain, at the failed target, has a number of step QPs, as the other rows needed none.

        Args:
            many: Lanes with these rows, whose targets are not set yet.
            x: Configurations of all chains, one after the other (rows, N) [rad or m].
            end: Index of each chain's last row.
        """
        first = np.concatenate([[0], end[:-1] + 1])
        before = np.concatenate([x[:1], x[:-1]])
        before[first] = self._starts[many.scenario[first]]
        target = np.arange(len(x)) - np.repeat(first, end - first + 1)
        iteration = np.zeros_like(many.iteration)
        iteration[end] = many.iteration[end]
        return many._replace(target=target.astype(np.int32), x_previous=before, iteration=iteration)

    def _write(self, many: Lanes, now: step_functions.State) -> None:
        self._record.track(many, now, Status.TRACKED_AFTER_RECOVERY, self._recovery, np.ones(many.size, np.int8))
        self._record.tracked -= many.size - len(np.unique(many.scenario))  # only the failed target is newly tracked

    def _replanned(self, lanes: Lanes, found: np.ndarray) -> BackwardsRound:
        """Return the round's result: lanes in their next phases, except those marked by `found`."""
        phases = np.array(
            [self._next(each, int(lost)) for each, lost in zip(self._of(lanes), lanes.target, strict=True)]
        )
        over = found | (phases == LOST)
        for scenario in lanes.scenario[over].tolist():
            del self._chains[scenario]
        going = tables.gather(lanes._replace(phase=phases.astype(np.int32)), ~over)
        return BackwardsRound(going, tables.gather(lanes, found), None, int((over & ~found).sum()))

    def _next(self, chains: Chains, lost: int) -> int:
        """Return the next phase of a scenario that failed at target `lost`."""
        if len(chains.x):
            return CHECKING if chains.x.shape[1] == lost + 1 else PUSHING
        return DRAWING if chains.rounds < self._rounds else LOST
