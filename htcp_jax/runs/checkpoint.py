"""Checkpoint of a reachability search: the results of finished targets, from which the same command continues.

    reachability/search.json     the search: its configuration, grid, files and options, and the program
    reachability/<number>.npz    results, see `reachability.memo`

A row of `place` is a result: index of its step in `steps` (JSON), scenario, target, length of its part of `numbers`.
The folder is in the output folder of the search while this runs or is interrupted, and is removed when it is finished.
Every file is written completely or not at all.
"""

import contextlib
import io
import json
import signal
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError, Interrupted, Note
from htcp_jax.io import arrays
from htcp_jax.jobs import Sweep
from htcp_jax.reachability import memo
from htcp_jax.runs.identity import identity, identity_differences
from htcp_jax.runs.input_files import recorded_inputs
from htcp_jax.runs.provenance import code_of_kinds, planned_by
from htcp_jax.system import files, lock, output_files, stop_message

FOLDER, SEARCH, RESULTS = "reachability", "search.json", "[0-9]*.npz"
EVERY_S = 5.0  # time between two files; a process that is killed loses the results since the last one


@contextlib.contextmanager
def checkpoint(out: Path, search: dict[str, Any], targets: Int[np.ndarray, "S"]) -> Iterator["Checkpoint"]:
    """Yield the checkpoint of a search in its output folder, and remove it at the end of the block.

    If the block is interrupted or fails, the results so far are kept.

    Args:
        out: The output folder of the search.
        search: The data that identify the search, for JSON; see `search_identity`.
        targets: Number of targets of each scenario.

    Raises:
        InputError: If the folder contains the checkpoint of another search, is in use or cannot be written.
        Interrupted: On Ctrl-C, instead of KeyboardInterrupt.
    """
    folder = out / FOLDER
    with output_files.made_folder(out):
        files.resolved_inside(folder, out)  # refuses a link that leaves the folder
        with output_files.made_folder(folder), lock.locked(folder):
            _begin(folder, search)
            found = Checkpoint(folder, targets)
            try:
                with stop_message(found.stop):
                    yield found
            except KeyboardInterrupt:
                raise Interrupted(found.stop(), signal.SIGINT) from None
            else:
                found.remove()
            finally:
                found.stop()


def search_identity(spec: Sweep, **options: Any) -> dict[str, Any]:
    """Return the data that identify a search: another search is refused where these differ.

    Args:
        spec: The sweep or job. The number of scenarios is not part of the identity.
        **options: Options of the search.

    Raises:
        InputError: If an input file cannot be read.
    """
    config, grid, hashes = recorded_inputs(spec)
    dtype = str(jax.dtypes.canonicalize_dtype(float))
    return identity(config, grid, dtype, hashes) | options | {"code": code_of_kinds(spec.config)}


class Checkpoint:
    """Results of a search in a folder, to which new ones are added. It is a `Memo`, which threads may share.

    Args:
        folder: The folder, which the caller has locked.
        targets: Number of targets of each scenario (S,).
    """

    def __init__(self, folder: Path, targets: Int[np.ndarray, "S"]):
        self._folder, self._count = folder, int(targets.sum())
        self._kept = _read(folder)
        self._known = {key[1:] for key in self._kept}  # scenarios and targets with results
        self._new: list[tuple[str, memo.Pairs, memo.Results]] = []  # not written yet
        self._lock, self._written, self._is_open = threading.Lock(), time.monotonic(), True

    @property
    def summary(self) -> str:
        """The number of targets with results, as text; "" if there are none."""
        return f"{len(self._known):,} of {self._count:,} targets" if self._known else ""

    def __call__(self, step: str, pairs: memo.Pairs, width: int, compute: memo.Compute) -> memo.Results:
        """Return the results of a step at some targets: those in the folder, and the others computed."""
        kept = [self._kept.get((step, *pair), ()) for pair in pairs.tolist()]
        is_kept = np.array([len(numbers) == width for numbers in kept])
        found, which = np.empty((len(pairs), width)), np.flatnonzero(~is_kept)
        for k in np.flatnonzero(is_kept):
            found[k] = kept[k]
        if len(which):
            found[which] = compute(which)
            self._add(step, pairs[which], found[which])
        return found

    def _add(self, step: str, pairs: memo.Pairs, results: memo.Results) -> None:
        with self._lock:
            if self._is_open:
                self._new.append((step, pairs, results))
                self._known |= set(map(tuple, pairs.tolist()))
                if time.monotonic() - self._written > EVERY_S:
                    self._write()

    def _write(self) -> None:
        number = max((int(file.stem) for file in self._folder.glob(RESULTS)), default=0) + 1
        steps = list(dict.fromkeys(step for step, _, _ in self._new))
        place = [
            np.column_stack([np.full(len(pairs), steps.index(step)), pairs, np.full(len(pairs), results.shape[1])])
            for step, pairs, results in self._new
        ]
        numbers = np.concatenate([results.ravel() for _, _, results in self._new])
        named = np.frombuffer(json.dumps(steps).encode(), np.uint8)
        stream = io.BytesIO()  # not Parquet, as pyarrow would import pandas
        np.savez(stream, steps=named, place=np.concatenate(place), numbers=numbers)
        files.write_atomically(self._folder, f"{number:06d}.npz", stream.getvalue())
        self._new, self._written = [], time.monotonic()

    def stop(self) -> str:
        """Write the results that are not written yet; return the message on how to continue.

        Later results are ignored. If there are no results, the folder is removed.
        """
        with self._lock:
            self._is_open = False  # also if the results cannot be written
            if self._new:
                self._write()
            if not self._known:
                _remove(self._folder)
                return "stopped before anything was finished; nothing was written"
            return f"stopped; results at {self.summary} are in {self._folder}; run the same command to resume"

    def remove(self) -> None:
        """Remove the folder, as the search is finished."""
        with self._lock:
            self._new, self._known, self._is_open = [], set(), False
            _remove(self._folder)


def _begin(folder: Path, search: dict[str, Any]) -> None:
    """Write search.json, or compare it with the search.

    Raises:
        InputError: If the folder contains another search, or results without search.json.
    """
    file = folder / SEARCH
    requested = json.loads(json.dumps({"search": search, "planned_by": planned_by()}))
    if not file.exists():
        if any(folder.glob(RESULTS)):
            raise InputError(f"{folder} contains results without {SEARCH}; delete the folder, or choose another --out")
        output_files.write_json(file, requested)
        return
    try:
        there = files.read_json(file, folder)
        differing, software = (identity_differences(there[key], requested[key]) for key in ("search", "planned_by"))
    except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
        words = f"{file} is damaged: {files.cause(error, file)}"
        raise InputError(f"{words}; delete {folder}, or choose another --out") from None
    if differing:
        more = f" (and {len(differing) - 1} more)" if differing[1:] else ""
        words = f"{folder} contains another search, which is not finished: {differing[0]}{more}"
        raise InputError(f"{words}; delete the folder, or choose another --out")
    if software:
        warnings.warn(f"{folder} is of other software, and its results are kept: {software[0]}", Note, stacklevel=4)


def _read(folder: Path) -> dict[tuple[str, int, int], Float[np.ndarray, "w"]]:
    """Return the results in a folder by step, scenario and target. Damaged files are reported and skipped."""
    found: dict[tuple[str, int, int], np.ndarray] = {}
    for file in sorted(folder.glob(RESULTS)):
        try:
            data = arrays.read_arrays(file, folder)
            steps, place = json.loads(data["steps"].tobytes()), data["place"].astype(int)
            each = np.split(data["numbers"].astype(float), np.cumsum(place[:-1, 3]))
            own = {(steps[k], s, t): row for (k, s, t, _), row in zip(place.tolist(), each, strict=True)}
        except (InputError, OSError, ValueError, TypeError, LookupError) as error:
            words = f"{files.cause(error, file)}; its results are computed again"
            warnings.warn(f"{file} is damaged: {words}", Note, stacklevel=4)
        else:
            found |= own
    return found


def _remove(folder: Path) -> None:
    """Remove a checkpoint; results first, so that they are never without the search that they belong to."""
    for file in (*folder.glob(RESULTS), folder / SEARCH, folder / lock.LOCK):
        file.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # it contains other files
        folder.rmdir()
