"""Results of a placement search, read from its folder: all planned mountings, and the ranked ones.

found = read_search("out/duct")
found.values, found.done, found.lost         # one row per mounting
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError
from htcp_jax.io import arrays
from htcp_jax.placement import mounting, ranges
from htcp_jax.runs import finite
from htcp_jax.runs import open as plan_sets
from htcp_jax.system import files


class SearchTable(NamedTuple):
    """Results of a search: n mountings with d parameters and A objectives; r mountings are ranked, best first."""

    name: str
    scenarios: int
    parameters: tuple[ranges.ShownParameter, ...]
    values: Float[np.ndarray, "n d"]  # parameters of all mountings, in display units
    done: Float[np.ndarray, "n"]  # share of targets that a proven motion reaches, over all seams
    complete: Bool[np.ndarray, "n"]
    lost: tuple[str, ...]  # reason why a mounting is not complete; empty if it is
    objectives: tuple[str, ...]
    left: Float[np.ndarray, "n A"]  # objectives by the quick plans, in display units; NaN if unknown
    ranked: Float[np.ndarray, "r d"]
    objective: Float[np.ndarray, "r A"]  # of the ranked mountings by proven motions, in display units; NaN: unknown
    worst: Float[np.ndarray, "r A"]  # worst objectives under perturbation; NaN if a perturbed mounting fails
    pareto_front: Bool[np.ndarray, "r"]
    seams: dict[str, int]  # number of mountings that complete each seam
    perturbed: str  # bounds of the perturbation as text, such as "3 mm and 0.5°"
    margin: Float[np.ndarray, "r"]  # margins of the ranked mountings [mm]; NaN if unknown
    is_final: bool  # False before the mountings have been perturbed

    def objective_name(self, k: int) -> str:
        """Return the label of the k-th objective's axis, with the unit."""
        return f"{self.objectives[k]} [{mounting.UNITS[self.objectives[k]][0]}]"


def read_search(folder: str | Path) -> SearchTable:
    """Read the results of a placement search from its folder.

    Raises:
        InputError: If the folder contains no search, if the search is not finished, or if a file is damaged.
    """
    folder = Path(folder)
    if not (folder / plan_sets.SEARCH).exists():
        raise InputError(f"{folder} contains no search of htcp place ({plan_sets.SEARCH})")
    if not (folder / mounting.RANKED).exists():
        raise InputError(f"{folder}: the search is not finished; run the same htcp place command to resume it")
    try:
        requested, reported = (files.read_json(folder / name, folder) for name in (plan_sets.SEARCH, mounting.RANKED))
        with files.opened(folder / mounting.MOUNTINGS, folder, files.LARGEST) as stream:
            table = arrays.read_parquet(stream, folder / mounting.MOUNTINGS)
        finite.check_table(table, "mountings", folder / mounting.MOUNTINGS)
        return _search_table(requested, reported, table)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, pa.ArrowException) as error:
        raise InputError(
            f"{folder} contains a damaged search: {error if isinstance(error, InputError) else repr(error)}"
        ) from None


def _search_table(requested: dict[str, Any], reported: dict[str, Any], table: pa.Table) -> SearchTable:
    names = table.column_names
    parameters = tuple(map(ranges.parameter, names[1 : names.index("done")]))
    objectives, rows = tuple(reported["objective"]), reported["ranked"]
    scale = np.array([one.scale for one in parameters])
    values = np.stack([table[one.column].to_numpy() for one in parameters], axis=1) * scale
    left = [mounting.UNITS[name][1] * table[name.replace(" ", "_")].to_numpy().astype(float) for name in objectives]
    ranked = np.array([[row["parameters"][one.column] for one in parameters] for row in rows])
    return SearchTable(
        name=reported["name"],
        scenarios=reported["scenarios"],
        parameters=parameters,
        values=values,
        done=table["done"].to_numpy(),
        complete=table["complete"].to_numpy(zero_copy_only=False),
        lost=tuple(words or "" for words in table["lost"].to_pylist()),
        objectives=objectives,
        left=np.stack(left, axis=1),
        ranked=ranked.reshape(-1, len(parameters)) * scale,
        objective=_objectives(rows, "objective", objectives),
        worst=_objectives(rows, "worst_objective", objectives),
        pareto_front=np.array([row["pareto_front"] for row in rows], bool),
        seams={name: seam["complete"] for name, seam in reported["seams"].items()},
        perturbed=f"{requested['perturbation']['mm']:g} mm and {requested['perturbation']['deg']:g}°",
        margin=1e3 * np.array([row["margin_m"] for row in rows], float),
        is_final=reported["finished"],
    )


def _objectives(rows: list[dict[str, Any]], which: str, objectives: tuple[str, ...]) -> Float[np.ndarray, "r A"]:
    found = [
        [mounting.UNITS[name][1] * (np.nan if row[which][name] is None else row[which][name]) for name in objectives]
        for row in rows
    ]
    found = np.array(found, float).reshape(-1, len(objectives))
    return np.where(np.isfinite(found), found, np.nan)
