"""Files that a configuration names, and the files that these refer to."""

from collections.abc import Iterable
from pathlib import Path

from htcp_jax.io import cell
from htcp_jax.io.robots import safe_xml
from htcp_jax.jobs import config_file
from htcp_jax.runs.identity import file_hash

PARTS = {
    "robot.model": safe_xml.model_files,
    "cell.model": cell.files_of_cell,
}  # functions that find the files to which a model refers


def anchor_files(config: dict) -> list[tuple[str, str]]:
    """Make the file names in a plain configuration absolute; return the dotted keys with these names."""
    named = []
    for dotted, owner, key in config_file.named_files(config):
        owner[key] = str(Path(owner[key]).resolve())
        named.append((dotted, owner[key]))
    return named


def file_hashes(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the SHA-256 by file name of files in a configuration, and of the files to which they refer.

    These are included models, and meshes of a cell's model.

    Args:
        named: Dotted keys with their file names.

    Raises:
        InputError: For a file that cannot be read.
    """
    found = {}
    for key, name in named:
        found[name] = file_hash(name)
        if (parts := PARTS.get(key)) is not None:
            found |= {str(part): file_hash(part) for part in sorted(parts(Path(name)) - {Path(name).resolve()})}
    return found
