"""Results of a placement search, and the files in its folder.

place.json            the search
ranked.json           the ranked mountings, see `Mounting`
mountings.parquet     every planned mounting: parameters, completed share of the targets, objectives, reason of failure
ranked/               a run with the motions of the ranked mountings
best-1.yaml           the job of the best mounting, for `htcp plan`, with all seams, and so on
"""

import contextlib
import json
import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import yaml

from htcp_jax.errors import InputError, Interrupted
from htcp_jax.io import arrays
from htcp_jax.jobs import load_config, with_weights
from htcp_jax.placement.mounting import MOUNTINGS, RANKED, Mounting
from htcp_jax.placement.place_file import Search
from htcp_jax.runs import columns as columns_of_files
from htcp_jax.runs import input_files, manifest, open_run, provenance
from htcp_jax.runs import open as plan_sets
from htcp_jax.spec import PlanConfig, examples
from htcp_jax.system import files, lock, output_files, stop_message

if TYPE_CHECKING:
    from htcp_jax.placement.scores import MountingScores

NOTHING = "no plan was finished and no file was written"


class PlacementResult(NamedTuple):
    """Results of a placement search."""

    folder: Path
    search: Search
    scores: Sequence["MountingScores"]
    mountings: Sequence[Mounting]  # best first
    motions: Path | None  # folder of the run with the mountings' motions; None if no mounting is ranked
    compile_s: float = 0.0  # time that the planner's calls spent on compilation
    is_final: bool = True  # False until perturbed mountings are planned and tolerances determined

    @property
    def scenarios(self) -> int:
        """Number of scenarios planned by the search."""
        return sum(len(each.plans.status) for each in self.scores)

    @property
    def complete(self) -> int:
        """Number of mountings at which quick plans lead to the end of every seam."""
        return sum(int(each.complete.sum()) for each in self.scores)

    def seams(self) -> dict[str, tuple[int, float]]:
        """Return, for each seam, the number of mountings that complete it, and its completed share at the best one."""
        part = self.search.job.workpiece
        names = self.search.seams or (part.path_label if part.seams else Path(part.path).stem,)
        done = np.concatenate([each.done for each in self.scores])
        best = done[np.lexsort((done.mean(axis=1), (done == 1).sum(axis=1)))[-1]]
        return {name: (int((done[:, k] == 1).sum()), float(best[k])) for k, name in enumerate(names)}

    def record(self) -> dict[str, Any]:
        """Return the result as a mapping for JSON."""
        return {
            "name": self.search.name,
            "finished": self.is_final,
            "margin_m": self.search.job.margin_m,  # margin of quick plans and of tolerances
            "scenarios": self.scenarios,
            "mountings": sum(len(each.values) for each in self.scores),
            "complete": self.complete,
            "seams": {name: {"complete": n, "in_the_best": share} for name, (n, share) in self.seams().items()},
            "objective": list(self.search.file.objective),
            "ranked": [self._row(one) | {"jobs": names} for one, names in zip(self.mountings, self.jobs, strict=True)],
        }

    @property
    def jobs(self) -> list[list[str]]:
        """Return the name of each ranked mounting's job file, in a list."""
        return [[f"best-{rank}.yaml"] for rank in range(1, len(self.mountings) + 1)]

    def _row(self, one: Mounting) -> dict[str, Any]:
        axes, file = self.search.ranges.axes, self.search.file
        known = {} if one.tolerance is None else {
            "tolerance": {
                "mm": one.tolerance.together * file.perturbation.mm,
                "deg": one.tolerance.together * file.perturbation.deg,
                "alone": {axis.name: v for axis, v in zip(axes, one.tolerance.alone.tolist(), strict=True)},
            }
        }  # fmt: skip
        return {
            "parameters": {axis.name: value for axis, value in zip(axes, one.values.tolist(), strict=True)},
            "margin_m": one.margin_m,
            "objective": {name: v for name, v in zip(file.objective, one.objective.tolist(), strict=True)},
            "worst_objective": {name: v for name, v in zip(file.objective, one.worst.tolist(), strict=True)},
            "success_rate": one.success_rate,
            "pareto_front": one.pareto_front,
            **known,
            **({"part_inside": one.inside._asdict()} if one.inside.solid else {}),
        }


@contextlib.contextmanager
def locked_search(folder: Path, search: Search) -> Iterator[None]:
    """Lock the search's folder, and restore it at the end if no plan was finished.

    Raises:
        InputError: If the folder contains another search, is in use or cannot be written.
        Interrupted: On Ctrl-C, instead of KeyboardInterrupt.
    """
    with output_files.made_folder(folder) as is_new, lock.locked(folder):
        for place, stages, _ in os.walk(folder):
            for stage in stages:
                files.resolved_inside(Path(place, stage), folder)  # refuses links that leave the folder
        _begin_search(folder, search)
        try:
            with stop_message(lambda: _stop_search(folder, is_new)):
                yield
        except (Interrupted, KeyboardInterrupt) as stop:
            code = stop.code - 128 if isinstance(stop, Interrupted) else signal.SIGINT
            raise Interrupted(_stop_search(folder, is_new), code) from None
        finally:
            _has_plans(folder, is_new)


def _stop_search(folder: Path, is_new: bool) -> str:
    """Return the message on how to resume; remove a new search without finished plans."""
    if _has_plans(folder, is_new):
        count = ranked_mountings(folder)
        counted = f"{count:,} mounting{'s' * (count != 1)}"
        ranking = f"the ranking so far of {counted} is in {folder / RANKED}; " if count else ""
        kept = f"{kept_plans(folder):,} finished plans are in {folder}"
        return f"stopped; {ranking}{kept}; run the same command to resume"
    return f"stopped; {NOTHING}"


def _has_plans(folder: Path, is_new: bool) -> bool:
    """Return True if a search has finished plans; if not, remove it."""
    if any(folder.glob("rounds/*/*/*.parquet")):
        return True
    (folder / plan_sets.SEARCH).unlink(missing_ok=True)
    if is_new:
        shutil.rmtree(folder, ignore_errors=True)
    return False


def ranked_plans(folder: Path) -> int:
    """Return the number of plans of the search when the ranking in its folder was written; 0 without a ranking."""
    return int(_ranking(folder).get("scenarios", 0))


def ranked_mountings(folder: Path) -> int:
    """Return the number of mountings in the ranking in a search's folder; 0 without a ranking."""
    return len(_ranking(folder).get("ranked", ()))


def _ranking(folder: Path) -> dict[str, Any]:
    try:
        return dict(files.read_json(folder / RANKED, folder))
    except (OSError, ValueError, TypeError):  # there is none, or it is damaged and will be replaced
        return {}


def kept_plans(folder: Path) -> int:
    """Return the number of finished plans in a search's folder, without the copies in `ranked`."""
    runs = [file.parent for file in folder.rglob(manifest.MANIFEST) if file.parent != folder / plan_sets.MOTIONS]
    return sum(shard.scenarios.rows for run in runs for shard in open_run(run).manifest.shards)


def _begin_search(folder: Path, search: Search) -> None:
    """Write place.json.

    Raises:
        InputError: If the folder contains another search.
    """
    requested = {
        **search.file.model_dump(mode="json"),
        "config": search.config,
        "overrides": list(search.overrides),
        "seams": list(search.seams),
    }
    file = folder / plan_sets.SEARCH
    if not file.exists():
        output_files.write_json(file, requested)
        return
    try:
        there = dict(files.read_json(file, folder))
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{file} is damaged: {files.cause(error, file)}") from None
    requested = json.loads(json.dumps(requested))
    there = requested | there  # a search of an earlier version may lack a key
    differing = [key for key in there if there[key] != requested.get(key) and key != "config"]
    if differing:
        key = differing[0]
        words = f"{key} is {there.get(key)} in the folder, {requested.get(key)} in this command"
        raise InputError(f"{folder} contains another search: {words}; delete the folder, or choose another --out")


def write_result(
    folder: Path,
    search: Search,
    scores: Sequence["MountingScores"],
    mountings: Sequence[Mounting],
    motions: Path | None,
    is_final: bool,
) -> PlacementResult:
    """Write the tables and the job files, and return the result.

    Args:
        folder: The search's folder.
        search: The search.
        scores: The results of every round.
        mountings: The ranked mountings, best first.
        motions: The folder of the run with the mountings' motions; None if no mounting is ranked.
        is_final: True if the ranking is final.
    """
    found = PlacementResult(folder, search, scores, mountings, motions, is_final=is_final)
    if motions is not None:
        _write_jobs(found, [point.config for point in open_run(motions).points()])
    files.write_atomically(folder, MOUNTINGS, arrays.parquet_bytes(_mounting_table(search, scores)))
    output_files.write_json(folder / RANKED, found.record())
    return found


def _write_jobs(found: PlacementResult, configs: Sequence[PlanConfig]) -> None:
    """Write a job file for every ranked mounting, with the search's job, all its seams and the keys that differ.

    Args:
        found: The result.
        configs: The jobs of the ranked mountings, one per seam.
    """
    search, names = found.search, [name for own in found.jobs for name in own]
    for old in found.folder.glob("best-*.yaml"):
        old.unlink()
    base = {} if search.config is None else {"config": str(examples.example_or_path(search.config).resolve())}
    plain, part = load_config(base.get("config")), load_config(search.config, search.overrides).workpiece
    for name, config in zip(names, configs[:: max(1, len(search.seams))], strict=True):
        without = with_weights(plain, len(config.settings.q_weights)).model_dump(mode="json")
        given = config.model_dump(mode="json")
        if search.seams:  # each of `configs` has one of them
            seams = [seam.model_dump(mode="json") for seam in part.seams]
            given["workpiece"] |= {"path": part.path, "seams": seams}
            for raw in (given, without):
                input_files.anchor_files(raw)
        own = _changed_keys(given, without) | {"method": search.file.confirm}
        text = f"# A mounting that htcp place ranked for {search.name}; htcp plan {name} gives its motion.\n"
        output_files.write_text(found.folder / name, text + yaml.safe_dump(base | own, sort_keys=False))


def _changed_keys(config: dict[str, Any], plain: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a job whose values differ from those in `plain`, by section."""
    found = {}
    for key, value in config.items():
        if isinstance(value, dict) and isinstance(plain.get(key), dict):
            value = _changed_keys(value, plain[key]) or plain[key]
        if value != plain.get(key):
            found[key] = value
    return found


def _mounting_table(search: Search, scores: Sequence["MountingScores"]) -> pa.Table:
    values = np.concatenate([each.values for each in scores])
    columns: dict[str, Any] = {"round": np.repeat(np.arange(len(scores)), [len(each.values) for each in scores])}
    columns |= {axis.name: values[:, k] for k, axis in enumerate(search.ranges.axes)}
    columns["done"] = np.concatenate([each.done.mean(axis=1) for each in scores])
    columns["complete"] = np.concatenate([each.complete for each in scores])
    objective = np.concatenate([each.objective for each in scores])
    for k, name in enumerate(search.file.objective):
        columns[name.replace(" ", "_")] = pa.array(objective[:, k], mask=~np.isfinite(objective[:, k]))
    columns["lost"] = [words or None for each in scores for words in each.lost()]
    return columns_of_files.described(
        pa.table(columns), Path(MOUNTINGS).stem, (), {"run": search.name, **provenance.planned_by()}
    )
