"""Planning the shards of a sweep in this process, one after the other."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import NamedTuple

import jax

from htcp_jax import planner
from htcp_jax.grid import Batch
from htcp_jax.plans import Plans
from htcp_jax.run_folder import Span
from htcp_jax.run_identity import planned_by
from htcp_jax.scenario import Scenario
from htcp_jax.settings import Settings


class Shard(NamedTuple):
    """One method on a block of scenarios."""

    method: str
    span: Span


class Planned(NamedTuple):
    """A shard's plans and what planned it, see `run_identity.planned_by`."""

    shard: Shard
    plans: Plans
    by: dict


def plan_here(
    batch: Batch, settings: Settings, threads: int | None, shards: Iterable[Shard], tell: Callable
) -> Iterator[Planned]:
    """The plans of the shards. tell(method, planner.Progress of the shard at hand) is called as a shard advances;
    what it raises ends the work. threads: see `planner.plan`."""
    by = planned_by()
    for shard in shards:
        plans = planner.plan(
            batch.robot,
            batch.workpiece,
            scenarios_of(batch, shard.span),
            shard.method,
            settings,
            progress=partial(tell, shard.method),
            threads=threads,
        )
        yield Planned(shard, plans, by)


def scenarios_of(batch: Batch, span: Span) -> Scenario:
    """The stacked scenarios of a block."""
    return jax.tree.map(lambda leaf: leaf[span.first : span.last + 1], batch.scenarios)
