"""Scenarios of a sweep, each with the complete configuration that plans it as a single job."""

import itertools
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.jobs.grid_axes import (
    FILE_KEYS,
    SEAM,
    AxisColumn,
    Group,
    ScenarioPoint,
    has_own_defaults,
    put_parameter,
    varied_keys,
)
from htcp_jax.jobs.resolve import with_weights
from htcp_jax.jobs.seam_keys import with_keys_of_only_seam
from htcp_jax.spec import DEPENDENT, PlanConfig, strict_model, value_at


def points_of(
    name: str,
    config: PlanConfig,
    groups: Sequence[Group],
    stated: Collection[str],
    joints: int,
    only: Collection[int] | None = None,
) -> Iterator[ScenarioPoint]:
    """Yield the scenarios of all grids in order.

    Args:
        name: Name of the sweep, for messages.
        config: Configuration shared by the scenarios.
        groups: The grids.
        stated: The keys in `DEPENDENT` that the configuration sets. The others get the defaults for each scenario's
            robot and workpiece.
        joints: Number of joints of all robots.
        only: Numbers of the scenarios to yield; None: all.

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
    texts = _Words(varied, short)
    number = itertools.count()
    for group in groups:
        own_defaults = has_own_defaults(group)
        shared = _without_defaults(base, {*stated, *group.keys}) if own_defaults else base
        values = _Values(config, shared)
        for row in group.rows():
            k = next(number)
            if only is not None and k not in only:
                continue
            own = None if own_defaults else values.varied(row)
            if own is None:
                raw = dict(shared)
                for column, value in row:
                    put_parameter(raw, column, value)
                own = strict_model.validate_model(raw, PlanConfig, f"{name}: scenario {k}")
            own = with_weights(with_keys_of_only_seam(own), joints)
            yield ScenarioPoint(k, group.name, own, texts.of(own))


class _Values:
    """Values of the keys of a configuration's first level, each validated once.

    Args:
        config: The configuration that is varied.
        shared: It as plain values.
    """

    def __init__(self, config: PlanConfig, shared: dict):
        self._config, self._shared = config, shared
        self._known: dict[tuple, Any] = {}  # by the parameters below the key, and their values

    def varied(self, row: Sequence[tuple[AxisColumn, Any]]) -> PlanConfig | None:
        """Return the configuration of a scenario; None if a value is invalid, which its own validation names.

        Args:
            row: The columns of the scenario, each with its value.
        """
        changes: dict[str, list[tuple[AxisColumn, Any]]] = {}
        for column, value in row:
            changes.setdefault(column.parameter.key.partition(".")[0], []).append((column, value))
        try:
            return self._config.model_copy(update={key: self._value(key, own) for key, own in changes.items()})
        except InputError:
            return None

    def _value(self, key: str, changes: Sequence[tuple[AxisColumn, Any]]) -> Any:
        about = key, *((id(column), repr(value)) for column, value in changes)  # 1, 1.0 and true are equal
        if about not in self._known:
            raw = dict(self._shared)
            for column, value in changes:
                put_parameter(raw, column, value)
            self._known[about] = getattr(strict_model.validate_model({key: raw[key]}, PlanConfig, key), key)
        return self._known[about]


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


class _Words:
    """JSON values of varied keys, each section of a configuration converted once.

    Args:
        varied: The keys.
        short: Short names of files, by key.
    """

    def __init__(self, varied: Sequence[str], short: Mapping[str, Mapping[str, str]]):
        self._keys: dict[str, list[str]] = {}  # by the key of the first level
        for key in varied:
            self._keys.setdefault("workpiece" if key == SEAM else key.partition(".")[0], []).append(key)
        self._order, self._short = varied, short
        self._known: dict[tuple[str, int], tuple[Any, dict[str, str]]] = {}  # with the value, so that its id stays

    def of(self, config: PlanConfig) -> dict[str, str]:
        """Return the JSON values of a configuration, by key."""
        found: dict[str, str] = {}
        for first, keys in self._keys.items():
            value = getattr(config, first)
            if (first, id(value)) not in self._known:
                raw = config.model_dump(mode="json", include={first})
                self._known[first, id(value)] = value, {key: self._word(key, raw) for key in keys}
            found |= self._known[first, id(value)][1]
        return {key: found[key] for key in self._order}

    def _word(self, key: str, raw: dict) -> str:
        value = raw["workpiece"]["seams"][0]["name"] if key == SEAM else value_at(raw, key)
        return json.dumps(self._short[key][value] if key in FILE_KEYS else value)
