"""Checks of a file's rows, and their arrangement in the order of the robot's joints."""

from decimal import Decimal

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.motions.motion_file import INTERPOLATIONS, MotionFile
from htcp_jax.io.motions.source import LARGEST, Rows, Source, listed

COARSEST = 5e-4  # largest rounding that is assumed for numbers with few digits [rad or m]
FLOAT = 1e-12  # rounding of 64-bit computations, relative to 1 + the value [1]


def arranged(source: Source, rows: Rows, format: str, requested: str | None) -> MotionFile:
    """Return the motion of a file's rows.

    Args:
        source: The file.
        rows: Its rows.
        format: Name of its format.
        requested: The required interpolation; None: the format's.

    Raises:
        InputError: For no or invalid configurations, times that do not increase, joints that differ from the robot's,
            and an interpolation that the file does not support.
    """
    interpolation = _interpolation(source, rows, requested)
    if rows.poses is not None:
        if not len(rows.poses):
            raise InputError(f"{source.file} contains no position")
        nothing, about = np.zeros((0, source.robot.dof)), (interpolation, format, rows.notes, rows.poses, rows.counted)
        return MotionFile(nothing, None, None, None, None, rows.line, None, *about)
    if not len(rows.values):
        raise InputError(f"{source.file} contains no configuration")
    for what, array in (("value", rows.values), ("velocity", rows.velocity), ("acceleration", rows.acceleration)):
        if array is None:
            continue
        # a follower's rates may be missing
        missing = np.isnan(array).all(axis=0) & np.array([name not in source.robot.joint_names for name in rows.names])
        if (wrong := np.argwhere(~(np.abs(array) < LARGEST) & ~missing)).size:
            n, m = wrong[0].tolist()
            where = f"{source.file}, {rows.counted} {rows.line[n]}"
            raise InputError(f"{where}: the {what} of {rows.names[m]} is {array[n, m]}; a finite number is needed")
    _check_times(source, rows)
    x, columns = _configurations(source, rows)
    rates = [None if rate is None else rate[:, columns] for rate in (rows.velocity, rows.acceleration)]
    about = rows.kind, interpolation, format, rows.notes
    corners = {"counted": rows.counted, "corner_share": rows.corner_share}
    return MotionFile(x, rows.time_s, *rates, rows.corner_m, rows.line, *about, **corners)


def _interpolation(source: Source, rows: Rows, requested: str | None) -> str:
    if requested is None:
        return rows.interpolation
    if requested not in INTERPOLATIONS:
        raise InputError(f"{requested!r} is not an interpolation; valid: {', '.join(INTERPOLATIONS)}")
    held = {"times": rows.time_s, "velocities": rows.velocity, "accelerations": rows.acceleration}
    needed = [*held][: {"linear": 0, "cubic": 2, "quintic": 3}[requested]]
    if missing := [name for name in needed if held[name] is None]:
        valid = ["linear"] + ["cubic"] * (rows.time_s is not None and rows.velocity is not None)
        text = f"{requested} interpolation needs {' and '.join(missing)}, which the file does not have"
        raise InputError(f"{source.file}: {text}; valid: {', '.join(valid)}")
    return requested


def _check_times(source: Source, rows: Rows) -> None:
    if rows.time_s is None:
        return
    where = f"{source.file}, {rows.counted}"
    if (wrong := np.flatnonzero(~(np.abs(rows.time_s) < LARGEST))).size:
        raise InputError(f"{where} {rows.line[wrong[0]]}: the time is {rows.time_s[wrong[0]]}; it must be finite")
    if (late := np.flatnonzero(~(np.diff(rows.time_s) > 0))).size:
        before, time = rows.time_s[late[0] : late[0] + 2].tolist()
        raise InputError(
            f"{where} {rows.line[late[0] + 1]}: the time is {time:.9g} s after {before:.9g} s; times must increase"
        )


def _configurations(source: Source, rows: Rows) -> tuple[Float[np.ndarray, "n N"], list[int]]:
    """Return the configurations, and the columns of the robot's joints.

    Raises:
        InputError: If the joints differ from the robot's, or if a follower or a locked joint has another value than the
            model's.
    """
    robot, names, locked = source.robot, rows.names, source.controller.locked
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(
            f"{source.file} has the joint {twice[0]} {names.count(twice[0])} times; its joints: {listed(names)}"
        )
    lacking = [name for name in robot.joint_names if name not in names]
    extra = [name for name in names if name not in {*robot.all_joint_names, *locked}]
    if lacking or extra:
        what = [f"the file lacks {listed(lacking)}"] * bool(lacking) + [f"the robot lacks {listed(extra)}"] * bool(
            extra
        )
        both = f"joints of {robot.name}: {listed(robot.joint_names)}; of the file: {listed(names) or 'none'}"
        raise InputError(f"{source.file}: {', and '.join(what)}; {both}{source.advice(names) if extra else ''}")
    values = rows.values if rows.scale is None else rows.values * rows.scale
    columns = [names.index(name) for name in robot.joint_names]
    x = values[:, columns]
    dependent = [m for m, name in enumerate(names) if name not in robot.joint_names]
    if dependent:
        _check_dependent(source, rows, values, x, columns, dependent)
    return x, columns


def _check_dependent(
    source: Source,
    rows: Rows,
    values: Float[np.ndarray, "n M"],
    x: Float[np.ndarray, "n N"],
    columns: list[int],
    dependent: list[int],
) -> None:
    """Check the columns of followers and locked joints.

    Raises:
        InputError: If a value differs from the model's by more than the file's rounding.
    """
    robot, rounding = source.robot, _rounding(rows, values)
    coupling = robot.coupling
    for m in dependent:
        name = rows.names[m]
        if coupling is not None and name in coupling.joint_names:
            j = coupling.joint_names.index(name)
            factors = np.asarray(coupling.factors)[j]
            expected = coupling.positions(x)[:, j]
            allowed = rounding[m] + np.abs(factors) @ rounding[columns]
            why = "it follows " + listed([robot.joint_names[k] for k in np.flatnonzero(factors)])
            for rate in (rows.velocity, rows.acceleration):
                _check_rate(source, rows, rate, m, columns, factors)
        else:
            expected = np.full(len(x), float(source.controller.locked[name]))
            allowed, why = rounding[m], "it is locked by the job"
        wrong = np.abs(values[:, m] - expected) > allowed + FLOAT * (1 + np.abs(expected))
        if wrong.any():
            n = int(wrong.argmax())
            where = f"{source.file}, {rows.counted} {rows.line[n]}"
            text = f"{name} is {values[n, m]:.9g} where the robot's model gives {expected[n]:.9g}"
            raise InputError(f"{where}: {text}, as {why}")


def _check_rate(
    source: Source, rows: Rows, rate: np.ndarray | None, m: int, columns: list[int], factors: Float[np.ndarray, "N"]
) -> None:
    """Check the velocity or acceleration of a follower, which must be its leader's times the factor.

    Raises:
        InputError: If a value differs by more than COARSEST.
    """
    if rate is None or not np.isfinite(rate[:, m]).all():
        return
    expected = rate[:, columns] @ factors
    wrong = np.abs(rate[:, m] - expected) > COARSEST * (1 + np.abs(expected))
    if wrong.any():
        n = int(wrong.argmax())
        text = f"a rate of {rows.names[m]} is {rate[n, m]:.9g} where the robot's model gives {expected[n]:.9g}"
        raise InputError(f"{source.file}, {rows.counted} {rows.line[n]}: {text}, as it follows another joint")


def _rounding(rows: Rows, values: Float[np.ndarray, "n M"]) -> Float[np.ndarray, "M"]:
    """Return half of the last digit of each column, at most COARSEST [rad or m]."""
    if rows.relative_rounding is not None:
        return rows.relative_rounding * np.abs(values).max(axis=0, initial=0.0)
    scale = np.ones(values.shape[1]) if rows.scale is None else np.abs(rows.scale)
    digits = np.array([max(map(_decimals, np.unique(column).tolist())) for column in rows.values.T])
    return np.minimum(0.5 * 10.0**-digits * scale, COARSEST)


def _decimals(number: float) -> int:
    exponent = Decimal(repr(number)).normalize().as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0
