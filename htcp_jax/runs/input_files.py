"""Files that a configuration names, and files that those include: their paths and hashes."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from htcp_jax.io import files_of_cell
from htcp_jax.io.robots import model_files
from htcp_jax.jobs import Sweep, grid_axes
from htcp_jax.runs.identity import file_hash
from htcp_jax.spec import config_file, model_source

PARTS = {
    **{f"{key}.model": model_files for key in model_source.KEYS},
    "cell.model": files_of_cell,
}  # by key: function that returns the files that a model file includes


def recorded_inputs(spec: Sweep) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, str]]:
    """Return the configuration and the grid of a sweep as recorded, and the SHA-256 of the files that they name.

    Raises:
        InputError: If a file cannot be read.
    """
    config = spec.config.model_dump(mode="json")
    grid = [grid_axes.group_record(group, spec.stated) for group in spec.groups]
    named = anchor_files(config)
    for axis in (axis for group in grid for axis in group["axes"]):
        named += [
            (key, name)
            for key, words in grid_axes.FILE_KEYS.items()
            for name in axis.get(key, {}).get("values", ())
            if name not in words
        ]
    return config, grid, file_hashes(named)


def anchor_files(config: dict) -> list[tuple[str, str]]:
    """Make the file names in a configuration of plain values absolute; return pairs of dotted key and file name."""
    named = []
    for dotted, owner, key in config_file.named_files(config):
        owner[key] = str(Path(owner[key]).resolve())
        named.append((dotted, owner[key]))
    return named


def file_hashes(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the SHA-256 of files and of the files that they include, by file name.

    Included files are those that a model includes, and the meshes of a cell's model.

    Args:
        named: Pairs of dotted key and file name, see `anchor_files`.

    Raises:
        InputError: If a file cannot be read.
    """
    found = {}
    for key, name in named:
        found[name] = file_hash(name)
        if (parts := PARTS.get(key)) is not None:
            found |= {str(part): file_hash(part) for part in sorted(parts(Path(name)) - {Path(name).resolve()})}
    return found
