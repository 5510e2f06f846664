"""Loading of a job from a file or a mapping and from overrides, with defaults and validation.

    load_config("plan.yaml", ["margin_m=0.001", "settings.alpha_rad=0.05"]) -> PlanConfig

The value of a key comes from an override, else from the file, else from its base file (see `config_file`), else from
the defaults for the job's arm and part (see `spec.defaults`). By default, a user-supplied part is at the world's origin
without rotation.

The files that a job names are not read; `resolve` adds what depends on the robot.

File names in a YAML file are relative to its folder, and file names in an override to the working folder.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.spec import (
    NAME,
    PlanConfig,
    TaskRowKind,
    example_or_path,
    exclude_path_or_seams,
    layers,
    layers_of,
    merged,
    obstacle_kind,
    parse_override,
    part_key,
    put_key,
    strict_model,
)


def load_config(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] | Mapping[str, Any] = ()
) -> PlanConfig:
    """Return the default job with the keys set by `config`, then by `overrides`.

    Args:
        config: A YAML file, the name of an example, or a mapping; file names in a mapping are relative to the working
            folder. None: the default job.
        overrides: Texts "dotted.key=value", or a mapping of dotted keys to values.

    Raises:
        InputError: If a file cannot be read, is not a YAML mapping or repeats a key; if base files form a cycle; if a
            key is unknown; or if a value has the wrong type or is out of its range.
    """
    raw, source = read_config(config, overrides)
    return strict_model.validate_model(raw, PlanConfig, source)


def read_config(
    config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str] | Mapping[str, Any]
) -> tuple[dict, str]:
    """Return the merged arguments of `load_config`, without defaults, and the name of the configuration for messages.

    Raises:
        InputError: See `load_config`; values are not checked here.
    """
    source, found = source_of(config), []
    if isinstance(config, Mapping):
        found = layers_of(config, source)
    elif config is not None:
        found = layers(example_or_path(config))
    for name, raw in found:
        strict_model.refuse_unknown(raw, PlanConfig, name)
    raw = merged(raw for _, raw in found)
    if "method" in raw and not NAME.fullmatch(str(raw["method"])):  # an error even if an override replaces it
        raise InputError(
            f"{source}: method is {raw['method']!r}; names consist of lower-case letters, digits and hyphens"
        )
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(parse_override, overrides)
    for dotted, value in pairs:
        put_key(raw, key := part_key(dotted), value)
        exclude_path_or_seams(raw, source, [key])
    strict_model.refuse_unknown(raw, PlanConfig, source)
    return raw, source


def source_of(config: str | Path | Mapping[str, Any] | None) -> str:
    """Return the name of a configuration for messages."""
    if config is None:
        return "the default configuration"
    return "the configuration" if isinstance(config, Mapping) else str(config)


def with_kinds(
    job: PlanConfig,
    obstacles: Sequence[obstacle_kind.ObstacleKind | Mapping[str, Any]],
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None,
) -> PlanConfig:
    """Return the job with additional obstacles, and with `task` in place of its own task.

    Args:
        job: The job.
        obstacles: Obstacles, as `ObstacleKind` values or as mappings as in a job file.
        task: Rows of the task, as `TaskRowKind` values or as mappings; None: the job's own task.

    Raises:
        InputError: If a value would be invalid in a job file.
    """
    if not obstacles and task is None:
        return job
    raw = job.model_dump()
    raw["cell"]["obstacles"] = [*job.cell.obstacles, *obstacles]
    raw["task"] = list(job.task if task is None else task)
    return strict_model.validate_model(raw, PlanConfig, "the arguments")


def seeded(overrides: Sequence[str] | Mapping[str, Any], seed: int | None) -> Sequence[str] | Mapping[str, Any]:
    """Return the overrides with `settings.seed` set to the seed; unchanged if the seed is None."""
    if seed is None:
        return overrides
    if isinstance(overrides, Mapping):
        return {**overrides, "settings.seed": seed}
    return [*overrides, f"settings.seed={seed}"]
