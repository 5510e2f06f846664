"""What `htcp ceiling` leaves in a run's folder."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.runs.run_folder import Run

CEILING = "ceiling.json"


class Reachable(NamedTuple):
    """How far sampling got in every scenario of a run."""

    prefix: np.ndarray  # (S,) targets in a row that are known to be reachable, of scenario 0, 1, ...
    draws: int
    seed: int


def read_ceiling(run: Run) -> Reachable | None:
    """The run's ceiling; None where none was searched. Raises InputError for a damaged file, and for one that is of
    another number of scenarios."""
    file = Path(run.folder) / CEILING
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        found = Reachable(np.asarray(record["prefix"], int), int(record["draws"]), int(record["seed"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file} is damaged or no result of htcp ceiling: {error}") from None
    if found.prefix.shape != (run.manifest.count,):
        raise InputError(f"{file} holds {found.prefix.size} scenarios, the run has {run.manifest.count}")
    return found
