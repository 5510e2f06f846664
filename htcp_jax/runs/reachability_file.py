"""The file that `htcp reachability` writes into a run's folder."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError, Note
from htcp_jax.io import files
from htcp_jax.reachability import Reach
from htcp_jax.runs.run_folder import Run

REACHABILITY = "reachability.json"


class ReachabilityBounds(NamedTuple):
    """Reachability bounds for every scenario of a run."""

    prefix: np.ndarray  # (S,) lower bound: consecutive targets known to be reachable, scenarios 0, 1, ...
    most: np.ndarray  # (S,) upper bound: targets not proven unreachable
    resolution_rad: float | None  # of the search; None if it sampled configurations within the joint limits
    seed: int
    each: np.ndarray | None = None  # (S, T) numbers of `Reach`, every target by itself; None if that was not required


WORDS = {reach.words: int(reach) for reach in Reach}


def read_reachability(run: Run) -> ReachabilityBounds | None:
    """Read the reachability bounds of a run; None without a search, or after an interrupted one.

    Raises:
        InputError: For a damaged file, and for another number of scenarios.
    """
    file = Path(run.folder) / REACHABILITY
    try:
        record = files.read_json(file, Path(run.folder))
        if isinstance(record, dict) and not record.get("complete", True):
            warnings.warn(f"{file} is incomplete and not used; htcp reachability creates it again", Note, stacklevel=2)
            return None
        found = _read_record(record)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{file} is damaged or no result of htcp reachability: {files.cause(error, file)}") from None
    counts = [found.prefix, found.most] + ([] if found.each is None else [found.each[:, 0]])
    if any(each.shape != (run.manifest.count,) for each in counts):
        raise InputError(f"{file} holds {found.prefix.size} scenarios, the run has {run.manifest.count}")
    return found


def _read_record(record: dict) -> ReachabilityBounds:
    prefix, most = (np.asarray(record[name], int) for name in ("prefix", "most"))
    resolution_rad = None if record["resolution_rad"] is None else float(record["resolution_rad"])
    each = record.get("each")
    if each is not None:
        each = np.array([[WORDS[word] for word in words] for words in each], np.int8).reshape(len(each), -1)
    return ReachabilityBounds(prefix, most, resolution_rad, int(record["seed"]), each)
