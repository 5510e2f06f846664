"""Tables of a placement search, read from its folder only: every planned mounting, and the ranked ones.

found = read_search("out/duct")
found.values, found.done, found.lost         # one row per mounting
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.placement import mounting, ranges
from htcp_jax.runs import open as plan_sets


class ShownParameter(NamedTuple):
    """A parameter that varies, for display."""

    column: str  # of mountings.parquet
    name: str  # shift x
    unit: str  # mm, °, or empty
    scale: float  # factor on the column's numbers

    @property
    def label(self) -> str:
        """Label of an axis, with the unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class SearchTable(NamedTuple):
    """Search with n mountings of d parameters and A objectives, of which r are ranked, the best first."""

    name: str
    scenarios: int
    parameters: tuple[ShownParameter, ...]
    values: Float[np.ndarray, "n d"]  # in the units of the parameters
    done: Float[np.ndarray, "n"]  # share of the targets, over all seams
    complete: Bool[np.ndarray, "n"]
    lost: tuple[str, ...]  # reason why it is not complete
    objectives: tuple[str, ...]
    left: Float[np.ndarray, "n A"]  # objectives in the units of `OBJECTIVES`; NaN if unknown
    ranked: Float[np.ndarray, "r d"]
    objective: Float[np.ndarray, "r A"]  # like `left`, of the proven motions
    worst: Float[np.ndarray, "r A"]  # its worst case under perturbation; NaN if one fails
    pareto_front: Bool[np.ndarray, "r"]
    seams: dict[str, int]  # number of mountings in which each is complete
    perturbed: str  # bounds of the perturbation: 3 mm and 0.5°
    margin: Float[np.ndarray, "r"]  # of the ranked ones [mm]; NaN if unknown
    is_final: bool  # False for a ranking that was written before mountings were perturbed

    def objective_name(self, k: int) -> str:
        """Label of an objective's axis, with its unit."""
        return f"{self.objectives[k]} [{mounting.UNITS[self.objectives[k]][0]}]"


def read_search(folder: str | Path) -> SearchTable:
    """Read the search in `folder`.

    Raises:
        InputError: For a folder without a search, for a search that is not finished, and for damaged files.
    """
    folder = Path(folder)
    if not (folder / plan_sets.SEARCH).exists():
        raise InputError(f"{folder} holds no search of htcp place ({plan_sets.SEARCH})")
    if not (folder / mounting.RANKED).exists():
        raise InputError(f"{folder}: the search is not finished; the same htcp place command resumes it")
    try:
        requested, reported = (files.read_json(folder / name, folder) for name in (plan_sets.SEARCH, mounting.RANKED))
        with files.opened(folder / mounting.MOUNTINGS, folder, files.LARGEST) as stream:
            return _search_table(requested, reported, files.read_parquet(stream, folder / mounting.MOUNTINGS))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, pa.ArrowException) as error:
        raise InputError(
            f"{folder} holds a damaged search: {error if isinstance(error, InputError) else repr(error)}"
        ) from None


def _search_table(requested: dict[str, Any], reported: dict[str, Any], table: pa.Table) -> SearchTable:
    names = table.column_names
    parameters = tuple(map(parameter, names[1 : names.index("done")]))
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


def parameter(column: str) -> ShownParameter:
    """Parse the name of a column, such as workpiece.shift_m.x: shift x, in mm."""
    parts, (unit, scale) = column.split("."), ("", 1.0)
    for k, part in enumerate(parts):
        for ending, reported in ranges.UNITS.items():
            if part.endswith(ending):
                parts[k], (unit, scale) = part.removesuffix(ending), reported
    parts = parts[1:] if parts[0] in ("workpiece", "robot") else parts
    return ShownParameter(column, " ".join(parts).replace("_", " "), unit, scale)
