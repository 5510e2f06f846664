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


class Parameter(NamedTuple):
    """A parameter that varies, for display."""

    column: str  # of mountings.parquet
    name: str  # shift x
    unit: str  # mm, °, or empty
    scale: float  # factor on the column's numbers

    @property
    def label(self) -> str:
        """Label of an axis, with the unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Searched(NamedTuple):
    """Search with n mountings of d parameters and A objectives, of which r are ranked, the best first."""

    name: str
    scenarios: int
    parameters: tuple[Parameter, ...]
    values: Float[np.ndarray, "n d"]  # in the units of the parameters
    done: Float[np.ndarray, "n"]  # share of the targets, over all seams
    complete: Bool[np.ndarray, "n"]
    lost: tuple[str, ...]  # reason why it is not complete
    aims: tuple[str, ...]
    left: Float[np.ndarray, "n A"]  # objectives in the units of `AIMS`; NaN if unknown
    ranked: Float[np.ndarray, "r d"]
    spare: Float[np.ndarray, "r A"]  # like `left`, of the proven motions
    off: Float[np.ndarray, "r A"]  # its worst case under perturbation; NaN if one fails
    front: Bool[np.ndarray, "r"]
    seams: dict[str, int]  # number of mountings in which each is complete
    disturbed: str  # bounds of the perturbation: 3 mm and 0.5°
    margin: Float[np.ndarray, "r"]  # of the ranked ones [mm]; NaN if unknown
    is_final: bool  # False for a ranking that was written before mountings were perturbed

    def aim(self, k: int) -> str:
        """Label of an objective's axis, with its unit."""
        return f"{self.aims[k]} [{mounting.UNITS[self.aims[k]][0]}]"


def read_search(folder: str | Path) -> Searched:
    """Read the search in `folder`.

    Raises:
        InputError: For a folder without a search, for a search that is not finished, and for damaged files.
    """
    folder = Path(folder)
    if not (folder / plan_sets.SEARCH).exists():
        raise InputError(f"{folder} holds no search of htcp place ({plan_sets.SEARCH})")
    if not (folder / mounting.RANKED).exists():
        raise InputError(f"{folder}: the search has not come to its end; the same htcp place goes on with it")
    try:
        asked, told = (files.read_json(folder / name, folder) for name in (plan_sets.SEARCH, mounting.RANKED))
        with files.opened(folder / mounting.MOUNTINGS, folder, files.LARGEST) as stream:
            return _searched(asked, told, files.read_parquet(stream, folder / mounting.MOUNTINGS))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, pa.ArrowException) as error:
        raise InputError(
            f"{folder} holds a damaged search: {error if isinstance(error, InputError) else repr(error)}"
        ) from None


def _searched(asked: dict[str, Any], told: dict[str, Any], table: pa.Table) -> Searched:
    names = table.column_names
    parameters = tuple(map(parameter, names[1 : names.index("done")]))
    aims, rows = tuple(told["spare"]), told["ranked"]
    scale = np.array([one.scale for one in parameters])
    values = np.stack([table[one.column].to_numpy() for one in parameters], axis=1) * scale
    left = [mounting.UNITS[name][1] * table[name.replace(" ", "_")].to_numpy().astype(float) for name in aims]
    ranked = np.array([[row["parameters"][one.column] for one in parameters] for row in rows])
    return Searched(
        name=told["name"],
        scenarios=told["scenarios"],
        parameters=parameters,
        values=values,
        done=table["done"].to_numpy(),
        complete=table["complete"].to_numpy(zero_copy_only=False),
        lost=tuple(words or "" for words in table["lost"].to_pylist()),
        aims=aims,
        left=np.stack(left, axis=1),
        ranked=ranked.reshape(-1, len(parameters)) * scale,
        spare=_aims(rows, "spare", aims),
        off=_aims(rows, "spare_when_off", aims),
        front=np.array([row["front"] for row in rows], bool),
        seams={name: seam["complete"] for name, seam in told["seams"].items()},
        disturbed=f"{asked['off']['mm']:g} mm and {asked['off']['deg']:g}°",
        margin=1e3 * np.array([row["margin_m"] for row in rows], float),
        is_final=told["finished"],
    )


def _aims(rows: list[dict[str, Any]], which: str, aims: tuple[str, ...]) -> Float[np.ndarray, "r A"]:
    found = [
        [mounting.UNITS[name][1] * (np.nan if row[which][name] is None else row[which][name]) for name in aims]
        for row in rows
    ]
    found = np.array(found, float).reshape(-1, len(aims))
    return np.where(np.isfinite(found), found, np.nan)


def parameter(column: str) -> Parameter:
    """Parse the name of a column, such as workpiece.shift_m.x: shift x, in mm."""
    parts, (unit, scale) = column.split("."), ("", 1.0)
    for k, part in enumerate(parts):
        for ending, told in ranges.UNITS.items():
            if part.endswith(ending):
                parts[k], (unit, scale) = part.removesuffix(ending), told
    parts = parts[1:] if parts[0] in ("workpiece", "robot") else parts
    return Parameter(column, " ".join(parts).replace("_", " "), unit, scale)
