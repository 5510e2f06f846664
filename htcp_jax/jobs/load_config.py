"""Loading of a configuration from a file, a mapping and overrides, validated and with its defaults.

    load_config("plan.yaml", ["margin_m=0.001", "settings.alpha_rad=0.05"]) -> PlanConfig

A key has the value that an override gives it, else that of the file (or of a file that it builds on), else the default
for the job's arm and part, see `defaults`: a part of one's own lies at the world's origin, not turned.

A file may have a base file, see `config_file`. File names in a YAML file are relative to its folder, those in an
override to the working folder.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from htcp_jax.clearance.obstacles import obstacle_kind
from htcp_jax.errors import InputError
from htcp_jax.io import strict_model
from htcp_jax.jobs.config import PlanConfig
from htcp_jax.jobs.config_file import layers, layers_of, merged, parse_override, put_key
from htcp_jax.jobs.defaults import fill_in, keys_of
from htcp_jax.jobs.examples import example_or_path
from htcp_jax.model import task_row_kind
from htcp_jax.registry import NAME


def load_config(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] | Mapping[str, Any] = ()
) -> PlanConfig:
    """Load the default job, changed by `config`, then by `overrides`.

    Args:
        config: A YAML file, the name of an example, or a mapping, whose files are relative to the working folder.
        overrides: "dotted.key=value" each, or a mapping.

    Raises:
        InputError: For a file that cannot be read, is not a YAML mapping or repeats a key, for a cycle of base files,
            for an unknown key, for a value of the wrong type or outside its range, and for a robot other than the GP50
            without a start.
    """
    raw, source = read_config(config, overrides)
    fill_in(raw, stated=keys_of(raw), source=source)
    return strict_model.validate_model(raw, PlanConfig, source)


def read_config(
    config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str] | Mapping[str, Any]
) -> tuple[dict, str]:
    """Merge the arguments of `load_config` into one mapping, without defaults; return it with its name for messages.

    Raises:
        InputError: As `load_config`, except for values.
    """
    source, found = "the default configuration", []
    if isinstance(config, Mapping):
        source = "the configuration"
        found = layers_of(config, source)
    elif config is not None:
        source = str(config)
        found = layers(example_or_path(config))
    for name, raw in found:
        strict_model.refuse_unknown(raw, PlanConfig, name)
    raw = merged(raw for _, raw in found)
    if "method" in raw and not NAME.fullmatch(str(raw["method"])):  # also if an override replaces it
        raise InputError(f"{source}: method is {raw['method']!r}; names are small letters, digits and hyphens")
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(parse_override, overrides)
    for dotted, value in pairs:
        put_key(raw, dotted, value)
    strict_model.refuse_unknown(raw, PlanConfig, source)
    return raw, source


def with_kinds(
    job: PlanConfig,
    obstacles: Sequence[obstacle_kind.ObstacleKind | Mapping[str, Any]],
    task: Sequence[task_row_kind.TaskRowKind | Mapping[str, Any]] | None,
) -> PlanConfig:
    """Return the job with further obstacles, and with another task unless it is None.

    Raises InputError for values that a job file could not state.
    """
    if not obstacles and task is None:
        return job
    raw = job.model_dump()
    raw["cell"]["obstacles"] = [*job.cell.obstacles, *obstacles]
    raw["task"] = list(job.task if task is None else task)
    return strict_model.validate_model(raw, PlanConfig, "the arguments")


def seeded(overrides: Sequence[str] | Mapping[str, Any], seed: int | None) -> Sequence[str] | Mapping[str, Any]:
    """Add the seed to overrides, as the key `settings.seed`."""
    if seed is None:
        return overrides
    if isinstance(overrides, Mapping):
        return {**overrides, "settings.seed": seed}
    return [*overrides, f"settings.seed={seed}"]
