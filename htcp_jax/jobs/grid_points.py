"""Scenarios of a sweep, each with the complete configuration that plans it as a single job."""

import itertools
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from htcp_jax.jobs.grid_axes import FILE_KEYS, Group, ScenarioPoint, has_own_defaults, put_parameter, varied_keys
from htcp_jax.jobs.resolve import with_weights
from htcp_jax.spec import DEPENDENT, PlanConfig, strict_model, value_at


def points_of(
    name: str, config: PlanConfig, groups: Sequence[Group], stated: Collection[str], joints: int
) -> Iterator[ScenarioPoint]:
    """Yield the scenarios of all grids in order.

    Args:
        name: Name of the sweep, for messages.
        config: Configuration shared by the scenarios.
        groups: The grids.
        stated: The keys in `DEPENDENT` that the configuration sets. The others get the defaults for each scenario's
            robot and workpiece.
        joints: Number of joints of all robots.

    Raises:
        InputError: If a value is out of its range.
    """
    base = config.model_dump()
    columns = [column for group in groups for axis in group.axes for column in axis]
    varied = varied_keys([column.parameter.name for column in columns])
    short = {}
    for key, words in FILE_KEYS.items():
        files = [value for column in columns if column.parameter.key == key for value in column.values]
        short[key] = short_names([*files, value_at(base, key)], words)
    number = itertools.count()
    for group in groups:
        shared = _without_defaults(base, {*stated, *group.keys}) if has_own_defaults(group) else base
        for row in group.rows():
            raw = dict(shared)
            for column, value in row:
                put_parameter(raw, column, value)
            k = next(number)
            own = with_weights(strict_model.validate_model(raw, PlanConfig, f"{name}: scenario {k}"), joints)
            yield ScenarioPoint(k, group.name, own, _words_of(own, varied, short))


def _without_defaults(base: dict, stated: Collection[str]) -> dict:
    """Return a configuration of plain values without the keys that have their own defaults in each scenario."""
    missing = DEPENDENT - {*stated}
    return {
        key: {name: own for name, own in value.items() if f"{key}.{name}" not in missing}
        if isinstance(value, dict)
        else value
        for key, value in base.items()
        if key not in missing
    }


def short_names(files: Iterable[str | None], words: Collection[str | None]) -> dict[str | None, str | None]:
    """Return a short name for each file: its last path components, as many as are needed to distinguish all files.

    Args:
        files: Paths of the files.
        words: Values that are not paths, such as names of built-in parts; they are not changed.
    """
    resolved = {file: Path(file).resolve() for file in files if file not in words}
    count = 1
    while len({path.parts[-count:] for path in resolved.values()}) < len(set(resolved.values())):
        count += 1
    return {word: word for word in words} | {file: "/".join(path.parts[-count:]) for file, path in resolved.items()}


def _words_of(config: PlanConfig, varied: Sequence[str], short: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    if not varied:
        return {}
    raw = config.model_dump(mode="json")
    values = {key: value_at(raw, key) for key in varied}
    return {key: json.dumps(short[key][value] if key in FILE_KEYS else value) for key, value in values.items()}
