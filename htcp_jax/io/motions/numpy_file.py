"""Arrays of NumPy: .npy with configurations, and .npz with configurations, times, velocities and names."""

from collections.abc import Mapping

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.arrays import read_archive, read_array
from htcp_jax.io.motions.csv_file import check_radians
from htcp_jax.io.motions.source import ANGLES, Rows, Source, listed

KEYS = {  # what an array holds, by its name
    "configurations": ("x", "q", "positions", "position", "configurations"),
    "times": ("time_s", "time", "times", "t"),
    "velocities": ("velocity", "velocities", "v", "qd", "dq"),
    "accelerations": ("acceleration", "accelerations", "a", "qdd", "ddq"),
    "names": ("joint_names", "names"),
}
OF_A_PLAN = {"segment_status", "path_clear"}  # arrays in a plan's trajectory.npz


def read_npy(source: Source) -> Rows:
    """Return the rows of an array (n, N), in the order of the robot's joints.

    Raises:
        InputError: If the array is damaged, or has another shape than the robot needs.
    """
    found = read_array(source.data, str(source.file))
    return _rows(source, {"configurations": found}, None, [])


def read_npz(source: Source) -> Rows:
    """Return the rows of an archive, see KEYS.

    Raises:
        InputError: If the archive is damaged, lacks configurations, or has arrays of different lengths.
    """
    arrays = read_archive(source.data, source.file, texts=True)
    if OF_A_PLAN <= arrays.keys():
        raise InputError(f"{source.file}: a plan's arrays with one row per target; its motion is in motion.csv")
    found: dict[str, np.ndarray] = {}
    used: list[str] = []
    for what, valid_names in KEYS.items():
        here = [name for name in valid_names if name in arrays]
        if len(here) > 1:
            raise InputError(f"{source.file}: the arrays {' and '.join(here)} both hold {what}")
        if here:
            found[what] = arrays[here[0]]
            used += here
    if "configurations" not in found:
        valid = ", ".join(KEYS["configurations"])
        raise InputError(f"{source.file} has no array of configurations; valid: {valid}; there: {listed([*arrays])}")
    unused = [name for name in arrays if name not in used]
    names = found.pop("names", None)
    if names is not None and (names.dtype.kind != "U" or names.ndim != 1):
        raise InputError(f"{source.file}: joint_names must be a list of texts")
    if names is None and source.joints:
        raise InputError(f"{source.file} has no joint_names, so that --joints does not apply to it")
    own = None if names is None else source.renamed(tuple(map(str, names.tolist())))
    return _rows(source, found, own, [f"Arrays that are not used: {listed(unused)}."] if unused else [])


def _rows(source: Source, found: Mapping[str, np.ndarray], names: tuple[str, ...] | None, notes: list[str]) -> Rows:
    """Return the rows of arrays.

    Raises:
        InputError: For shapes that do not fit the robot or each other.
    """
    robot, raw = source.robot, found["configurations"]
    for what, array in found.items():
        if array.dtype.kind not in "fiu":
            raise InputError(f"{source.file}: the {what} must be numbers")
    own = robot.all_joint_names if raw.ndim == 2 and raw.shape[1] == len(robot.all_joint_names) else robot.joint_names
    if names is None:
        names = robot.joint_names if raw.ndim == 2 and raw.shape[1] == robot.dof else own
        notes = [f"No names: the columns are {listed(names)}.", *notes]
    if raw.ndim != 2 or raw.shape[1] != len(names):
        joints = f"{len(names)} joints: {listed(names)}"
        raise InputError(f"{source.file}: configurations of shape {raw.shape}; needed: (n, {len(names)}), for {joints}")
    n = len(raw)
    for what, array in found.items():
        shape = (n,) if what == "times" else (n, len(names))
        if array.shape != shape:
            raise InputError(f"{source.file}: {what} of shape {array.shape}; needed: {shape}, as the configurations")
    by_name = dict(zip(robot.all_joint_names, robot.slides, strict=True))
    by_name |= dict(zip(robot.joint_names, robot.sliding, strict=True))
    hinges = [m for m, name in enumerate(names) if not by_name.get(name, False)]
    rows = np.arange(1, n + 1)
    values = raw.astype(float)
    check_radians(source, values[:, hinges], rows, "row")
    scale = np.ones(len(names))
    scale[hinges] = ANGLES[source.unit or "rad"]
    if source.unit is None:
        notes = ["No unit is stated: angles are read in radians.", *notes]
    rates = {what: found[what].astype(float) * scale for what in ("velocities", "accelerations") if what in found}
    return Rows(
        names,
        values,
        rows,
        scale=scale,
        time_s=found["times"].astype(float) if "times" in found else None,
        velocity=rates.get("velocities"),
        acceleration=rates.get("accelerations"),
        notes=tuple(notes),
        counted="row",
        relative_rounding=float(np.finfo(raw.dtype).eps) if raw.dtype.kind == "f" else None,
    )
