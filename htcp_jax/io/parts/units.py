"""Plausibility checks that a workpiece, its path and the robot are all in metres, by their sizes and distances.

A reachable part is not much larger than the arm and not much smaller than the arm's thinnest body, and a path is near
its part. A part larger than 5 times the reach, or 5 times smaller than the thinnest body, is refused; smaller
deviations cause a warning. The message names the unit that would make the sizes plausible.
"""

import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.parts.columns import PER_METRE
from htcp_jax.io.parts.scan import OF_ONE_UNIT
from htcp_jax.model import Robot, kinematics, median_distance

METRES = {"millimetres": 1e-3, "inches": 0.0254, "centimetres": 0.01, "kilometres": 1e3}  # the most likely units first
KEYS = {"millimetres": "mm", "inches": "in", "centimetres": "cm", "metres": "m"}  # values of `workpiece.unit`
LARGE = 2.0  # ratio of a part's size to the arm's reach from which on a warning is given
ABSURD = 5.0  # ratio of sizes from which on a part is refused, see the module's docstring
REMEDY = 'check that lengths are in metres; a mesh in millimetres needs scale="0.001 0.001 0.001" in the model'
TOOL_M = 0.01, 3.0  # smallest and largest plausible size of a tool's mesh [m]
HALL = 50.0  # ratio of the size of a cell's mesh or cloud to the arm's reach from which on a warning is given
STAND_OFF = 0.5  # factor of the largest plausible distance of a path from its part, see `_stand_off`


def unit_key(file: str) -> str | None:
    """Return the job's key for the unit of a part's file; None if the file or its format states the unit.

    Args:
        file: The file's name, or a label without an ending for a part that is not from a file.
    """
    return None if Path(file).suffix.lower() in ("", *OF_ONE_UNIT) else "workpiece.unit"


def check_extent(
    robot: Robot,
    part: Float[np.ndarray, "P 3"],
    path: Float[np.ndarray, "T 3"],
    name: str,
    key: str | None = None,
    unit: str | None = None,
) -> None:
    """Check that the size of a part is plausible for the arm.

    A UserWarning reports a part more than twice as large as the arm's reach, or smaller than the arm's thinnest body.

    Args:
        robot: The arm.
        part: Points that have the extent of the part [m].
        path: The tool path [m], for a guess at the unit.
        name: The part's name, for messages.
        key: The job's key for the unit of the part's file; None: there is none.
        unit: The value of this key; None: not set.

    Raises:
        InputError: For an implausible size.
    """
    factor = PER_METRE[unit or "m"]  # to the numbers in the file
    extent, longest = _extent(part), kinematics.max_reach(robot)
    thinnest = 2.0 * float(np.asarray(robot.capsule_radius).min())
    fitting = [
        other
        for other, metres in {**METRES, **({} if unit in (None, "m") else {"metres": 1.0})}.items()
        if 2.0 * thinnest <= metres * factor * extent <= LARGE * longest
    ]
    if extent > LARGE * longest:
        text = f"{name} extends over {extent:.3g} m, {robot.name} reaches {longest:.3g} m"
        _report(f"{text}; {_part_hint(factor * part, path, fitting, key)}", extent > ABSURD * longest)
    elif extent < thinnest:
        text = f"{name} extends over {extent:.3g} m, the thinnest body of {robot.name} over {thinnest:.3g} m"
        _report(f"{text}; {_part_hint(factor * part, path, fitting, key)}", extent < thinnest / ABSURD)


def check_cell_extent(robot: Robot, points: Float[np.ndarray, "P 3"], name: str, key: str) -> None:
    """Warn of a mesh or cloud of the cell that is larger than any workshop.

    Args:
        robot: The arm.
        points: Points that have its extent [m].
        name: Its name.
        key: What states its unit.
    """
    if (extent := _extent(points)) > HALL * (longest := kinematics.max_reach(robot)):
        text = f"{name} extends over {extent:.3g} m, {robot.name} reaches {longest:.3g} m; check its unit: {key}"
        warnings.warn(text, UserWarning, stacklevel=3)


def check_tool(robot: Robot, extension_m: float = 0.0) -> None:
    """Check that the tool and the bodies of an arm are in metres.

    A UserWarning reports a tool more than twice as long as the arm's links together, and a body thicker than that.

    Raises:
        InputError: For an implausible length or radius.
    """
    tip = float(np.linalg.norm(np.asarray(robot.T_link_tcp)[:3, 3]))
    links, length, thickest = (
        kinematics.max_reach(robot) - tip,
        tip + abs(extension_m),
        float(np.asarray(robot.capsule_radius).max()),
    )
    measured = f"the links of {robot.name} measure {links:.3g} m"
    if length > LARGE * links:
        text = f"{measured}, but the TCP is {length:.3g} m from the last joint; check that lengths are in metres"
        _report(text, length > ABSURD * links)
    if thickest > links:
        _report(f"{measured}, but a body has a radius of {thickest:.3g} m; {REMEDY}", thickest > ABSURD * links)


def check_tool_extent(
    mesh: Float[np.ndarray, "P 3"], tip: Float[np.ndarray, "3"], name: str, unit: str | None = None
) -> None:
    """Check that a tool's mesh has a plausible size, and that its tip is near it.

    Args:
        mesh: Points of the mesh [m].
        tip: The tip, in the mesh's frame [m].
        name: The mesh's name, for messages.
        unit: Unit in which its file was read; None: m, or the unit that the file states.

    Raises:
        InputError: For an implausible size, and for a tip that is farther from the mesh than the mesh is long.
    """
    (least, most), extent = TOOL_M, _extent(mesh)
    if not least <= extent <= most:
        size = PER_METRE[unit or "m"] * extent
        units = [unit for name, unit in KEYS.items() if least <= METRES.get(name, 1.0) * size <= most]
        remedy = f"it seems to be in {units[0]}; pass --unit {units[0]}" if units else "check the file"
        raise InputError(f"{name} extends over {extent:.3g} m, but a tool over {least:g} to {most:g} m; {remedy}")
    if (away := float(np.linalg.norm(mesh - tip, axis=1).min())) > extent:
        raise InputError(
            f"--tip is {away:.3g} m from {name}, which extends over {extent:.3g} m; both must be in the same frame and "
            "unit"
        )


def check_path_unit(
    cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], name: str, unit: str | None = None
) -> None:
    """Check that a path is near its part.

    Args:
        cloud: The part's points [m].
        path: The tool path [m].
        name: The part's name, for messages.
        unit: Unit in which the path's file was read; None: it states none, so that metres were assumed.

    Raises:
        InputError: If the median distance of the path's points from the cloud is too large.
    """
    if (distance := median_distance(cloud, path)) > _stand_off(cloud):
        raise InputError(f"half of the path is {distance:.3g} m or more from {name}; {_path_hint(cloud, path, unit)}")


def _report(text: str, absurd: bool) -> None:
    if absurd:
        raise InputError(text)
    warnings.warn(text, UserWarning, stacklevel=3)


def _part_hint(
    part: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], units: list[str], key: str | None
) -> str:
    """Return a hint at the length unit of a part that is too large or too small, and of its path.

    Args:
        part: The part, in the numbers of its file.
        path: The path [m].
        units: The units in which the part has a plausible size, the most likely first; the one in which the part is
            nearest to its path is named.
        key: See `check_extent`.
    """
    if not units:
        return "check that it is in metres, and keep only the part that the arm can reach"
    scaled = {unit: METRES.get(unit, 1.0) * part for unit in units}
    distances = {unit: median_distance(points, path) for unit, points in scaled.items()}
    near = [unit for unit in units if distances[unit] <= _stand_off(scaled[unit])]
    unit = min(near, key=distances.__getitem__, default=units[0])
    keys = [each for each in (key, None if near else "workpiece.path_unit") if each]
    whose = "it seems" if near else "it and its path seem"
    if key is None or unit not in KEYS:
        return f"{whose} to be in {unit}; convert to metres (factor {METRES.get(unit, 1.0):g})"
    return f"{whose} to be in {unit}; set {' and '.join(f'{each}: {KEYS[unit]}' for each in keys)}"


def _path_hint(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], read_in: str | None) -> str:
    """Return a hint at the length unit of a path that is far from its part; it was read in the unit `read_in`."""
    extent, factors = _extent(cloud), METRES if read_in is None else METRES | {"metres": 1.0}
    for unit, in_file in sorted(factors.items(), key=lambda item: -item[1]):
        metres = PER_METRE[read_in or "m"] * in_file
        # With too small a unit any path is at the origin, but too short.
        right_length = 0.05 * extent <= metres * _extent(path) <= 2.0 * extent
        if right_length and median_distance(cloud, metres * path) <= 0.5 * extent:
            if read_in is not None and unit in KEYS:
                read_as = next(name for name, key in KEYS.items() if key == read_in)
                return f"it was read as {read_as}, but seems to be in {unit}; set workpiece.path_unit: {KEYS[unit]}"
            key = f", or set workpiece.path_unit: {KEYS[unit]}" if unit in KEYS else ""
            return f"the path seems to be in {unit}; convert it to metres (factor {metres:g}){key}"
    return "both must be in metres and in the same frame"


def _stand_off(cloud: Float[np.ndarray, "P 3"]) -> float:
    return max(STAND_OFF, STAND_OFF * _extent(cloud))


def _extent(points: Float[np.ndarray, "P 3"]) -> float:
    return float(np.ptp(points, axis=0).max())
