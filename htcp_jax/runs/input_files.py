"""The files that a configuration names, and those that these name in turn."""

from collections.abc import Iterable
from pathlib import Path

from htcp_jax.io.cell import files_of_cell
from htcp_jax.io.safe_xml import files_of
from htcp_jax.jobs.config_file import named_files
from htcp_jax.runs.identity import file_hash

PARTS = {"robot.model": files_of, "cell.model": files_of_cell}  # the files of which one named so is made


def anchor_files(config: dict) -> list[tuple[str, str]]:
    """Make the names of files in a configuration absolute, which is in its plain form; returns the dotted keys that
    name them, and them."""
    named = []
    for dotted, owner, key in named_files(config):
        owner[key] = str(Path(owner[key]).resolve())
        named.append((dotted, owner[key]))
    return named


def file_hashes(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """SHA-256 by name of files that are named under some keys of a configuration, and of those that they name
    themselves: what models include, and the meshes of a cell's. Raises InputError."""
    found = {}
    for key, name in named:
        found[name] = file_hash(name)
        if (parts := PARTS.get(key)) is not None:
            found |= {str(part): file_hash(part) for part in sorted(parts(Path(name)) - {Path(name).resolve()})}
    return found
