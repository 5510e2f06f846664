"""The file that `htcp reachability` writes into a run's folder."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError, Note
from htcp_jax.reachability import Reach
from htcp_jax.runs.run_folder import Run
from htcp_jax.system import files

REACHABILITY = "reachability.json"


class ReachabilityBounds(NamedTuple):
    """Reachability bounds for every scenario of a run."""

    prefix: np.ndarray  # (S,) lower bound: number of targets, from the first on, that are reachable
    most: np.ndarray  # (S,) upper bound: number of targets before the first one that is proven unreachable
    resolution_rad: float | None  # resolution of tool orientations; None if configurations were sampled
    seed: int  # random seed of the search
    each: np.ndarray | None = None  # (S, T) values of `Reach` for each target by itself; None if not computed


WORDS = {reach.words: int(reach) for reach in Reach}


def read_reachability(run: Run) -> ReachabilityBounds | None:
    """Return the reachability bounds of a run's scenarios; None if they have not been computed completely.

    If only some scenarios of the grid are planned, row s is scenario s, up to the last one, as in `Run.plans`. The file
    then has all scenarios of the grid.

    Raises:
        InputError: If the file is damaged, or if it has another number of scenarios than the run.
    """
    file = Path(run.folder) / REACHABILITY
    try:
        record = files.read_json(file, Path(run.folder))
        if isinstance(record, dict) and not record.get("complete", True):
            warnings.warn(f"{file} is incomplete and not used; run htcp reachability again", Note, stacklevel=2)
            return None
        found = _read_record(record)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{file} is damaged or not a result of htcp reachability: {files.cause(error, file)}"
        ) from None
    counts = [found.prefix, found.most] + ([] if found.each is None else [found.each[:, 0]])
    manifest = run.manifest
    expected, of = (manifest.count, "run") if manifest.scenarios is None else (manifest.full, "grid")
    if any(each.shape != (expected,) for each in counts):
        raise InputError(f"{file} contains {found.prefix.size} scenarios, but the {of} has {expected}")
    if manifest.scenarios is None:
        return found
    each = None if found.each is None else found.each[: manifest.rows]
    return found._replace(prefix=found.prefix[: manifest.rows], most=found.most[: manifest.rows], each=each)


def _read_record(record: dict) -> ReachabilityBounds:
    prefix, most = (np.asarray(record[name], int) for name in ("prefix", "most"))
    resolution_rad = None if record["resolution_rad"] is None else float(record["resolution_rad"])
    each = record.get("each")
    if each is not None:
        each = np.array([[WORDS[word] for word in words] for words in each], np.int8).reshape(len(each), -1)
    return ReachabilityBounds(prefix, most, resolution_rad, int(record["seed"]), each)
