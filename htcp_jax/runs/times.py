"""Tables of a run's planning times, by shard and by scenario.

The times are in manifest.json only, so that equal plans give equal Parquet files, for any size of the shards.
"""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from htcp_jax.runs.manifest import METHOD_NOUN, Manifest

SEED = "settings.seed"  # column of the table of scenarios, if the seed varies
SECONDS = "run_s", "cpu_s"
SHARDS = pa.schema(
    [
        ("method", pa.string()),
        *((name, pa.int64()) for name in ("first", "last", "scenarios", "targets", "tracked", "cores")),
        *((name, pa.float64()) for name in (*SECONDS, "compile_s")),
        *((name, pa.string()) for name in ("device", "commit", "package")),
    ]
)
TIMES = pa.schema(
    [
        ("method", pa.string()),
        *((name, pa.int64()) for name in ("scenario", "attempted", "together")),
        *((name, pa.float64()) for name in SECONDS),
        ("seed", pa.int64()),
        ("package", pa.string()),
    ]
)


def shard_table(manifest: Manifest) -> pa.Table:
    """Return one row per finished shard: its scenarios, its times, and what planned it.

    `run_s` is the wall time of planning, without `compile_s`, the wall time of compilation. `cpu_s` is the processor
    time of all threads and processes, without that of compilation before planning; null in runs of older versions [s].
    `cores` is the number of CPU cores that planned, null in runs of older versions. `package` is the installed package
    and version of a method that is not built in.
    """
    rows = []
    for shard in manifest.shards:
        by = manifest.planned_by[shard.planned_by]
        rows.append(
            {
                **shard.model_dump(include={"method", "first", "last", "tracked", "cores", *SECONDS, "compile_s"}),
                "scenarios": shard.scenarios.rows,
                "targets": shard.targets.rows,
                **{name: by.get(name) for name in ("device", "commit")},
                "package": _package(manifest, shard.method),
            }
        )
    return pa.Table.from_pylist(rows, SHARDS)


def time_table(manifest: Manifest, scenarios: pa.Table) -> pa.Table:
    """Return one row per method and scenario: its share of the planning time, its seed, and the method's package.

    The scenarios of a shard are planned together. `run_s` and `cpu_s` of a scenario are the shard's times [s] (see
    `shard_table`), multiplied by `attempted` and divided by the sum of `attempted` in the shard. `attempted` is the
    number of tracked targets, plus 1 for the target at which the scenario ended. `together` is the number of scenarios
    in the shard; if it is 1, the times are measured.

    Args:
        manifest: The run's manifest.
        scenarios: Rows of the table of scenarios.
    """
    attempted = np.where(
        scenarios["complete"], scenarios["targets"], pc.add(pc.fill_null(scenarios["failed_target"], 0), 1)
    )
    shard_of = {(s.method, number): k for k, s in enumerate(manifest.shards) for number in s.scenario_numbers}
    methods, numbers = (scenarios[name].to_pylist() for name in ("method", "scenario"))
    which = np.array([shard_of[key] for key in zip(methods, numbers, strict=True)])
    sums = np.bincount(which, attempted, len(manifest.shards))
    columns = {name: [getattr(shard, name) for shard in manifest.shards] for name in SECONDS}
    seconds = {name: np.array(values, float)[which] * attempted / sums[which] for name, values in columns.items()}
    seeds = [int(text) for text in scenarios[SEED].to_pylist()] if SEED in scenarios.column_names else manifest.seed
    return pa.table(
        {
            "method": methods,
            "scenario": numbers,
            "attempted": attempted,
            "together": np.array([shard.scenarios.rows for shard in manifest.shards])[which],
            **{name: pa.array(values, mask=np.isnan(values)) for name, values in seconds.items()},
            "seed": np.broadcast_to(seeds, len(methods)),
            "package": [_package(manifest, method) for method in methods],
        },
        TIMES,
    )


def _package(manifest: Manifest, method: str) -> str | None:
    return manifest.plugins.get(f"{METHOD_NOUN} {method}")
