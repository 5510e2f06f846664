"""Orientations from the three angles of robot makers.

Sources, compared in docs/paths.md: the pose formats in the documentation of Basler's rc_visard (KUKA, FANUC,
Kawasaki, Mitsubishi, Yaskawa), of Vathos (ABB, Doosan, Universal Robots) and of Mech-Mind (Comau, DENSO, Staubli); REP
103 of ROS.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.headings import listed
from htcp_jax.io.parts.path_table import PathTable
from htcp_jax.spec import CHOSEN_ANGLES, Maker

ROTATION_VECTOR = "vector"
ABC, AER, OAT, WPR = ("a", "b", "c"), ("a", "e", "r"), ("o", "a", "t"), ("w", "p", "r")
RX_RY_RZ, RPY = ("rx", "ry", "rz"), ("roll", "pitch", "yaw")
RTDE = tuple(tuple(f"{name}_tcp_pose_{k}" for k in (3, 4, 5)) for name in ("actual", "target"))
KEY = "workpiece.path_angles"


class AngleOrder(NamedTuple):
    """Meaning of a maker's three angles."""

    names: tuple[str, ...]  # in the maker's order
    axes: str  # as in scipy: capitals for axes of the rotated frame, else fixed axes; or ROTATION_VECTOR
    unit: str = "deg"  # of a header without unit


ORDERS: dict[str, AngleOrder] = {
    "abb": AngleOrder(RX_RY_RZ, "xyz"),
    "comau": AngleOrder(AER, "ZYZ"),
    "denso": AngleOrder(RX_RY_RZ, "xyz"),
    "doosan": AngleOrder(ABC, "ZYZ"),
    "fanuc": AngleOrder(WPR, "xyz"),
    "kawasaki": AngleOrder(OAT, "ZYZ"),
    "kuka": AngleOrder(ABC, "ZYX"),
    "mitsubishi": AngleOrder(ABC, "xyz"),
    "ros": AngleOrder(RPY, "xyz", "rad"),
    "staubli": AngleOrder(RX_RY_RZ, "XYZ"),
    "ur": AngleOrder(RX_RY_RZ, ROTATION_VECTOR, "rad"),
    "yaskawa": AngleOrder(RX_RY_RZ, "xyz"),
}
CERTAIN = {WPR: "fanuc", OAT: "kawasaki", **dict.fromkeys(RTDE, "ur")}  # names that only one maker uses
FAMILIES = (CHOSEN_ANGLES, WPR, OAT, ABC, AER, RX_RY_RZ, RPY, *RTDE)


def rotations_of(
    table: PathTable, found: Sequence[tuple[str, ...]], maker: Maker | None, source: str
) -> Float[np.ndarray, "P 3 3"] | None:
    """Return the orientations that a table's angles state; None, with a Note, if they cannot be read with certainty.

    A Note names angles that are ignored next to others.

    Args:
        table: The table.
        found: The families of FAMILIES that the table has.
        maker: The maker whose order and unit the angles have; None: the one whose names they have.
        source: The file, for messages.

    Raises:
        InputError: With a maker: if the table lacks its angles, for angles that are not numbers, and for an unknown
            unit.
    """
    if maker is not None:
        names = (CHOSEN_ANGLES, ORDERS[maker].names, *(RTDE if maker == "ur" else ()))
        family = next((family for family in names if family in found), None)
        if family is None:
            text = (
                f"{KEY} is {maker}, whose angles are {', '.join(ORDERS[maker].names)}, but the path has no such columns"
            )
            raise InputError(f"{source}: {text}; choose them with workpiece.path_columns: {', '.join(CHOSEN_ANGLES)}")
        table.name_ignored(family, found)
        return _rotations(table, family, ORDERS[maker], source)
    unread = list(found)
    while unread and unread[0] in CERTAIN:
        try:
            rotations = _rotations(table, unread[0], ORDERS[CERTAIN[unread[0]]], source)
        except InputError as error:  # columns of these names may hold something else
            warnings.warn(f"{error}; the columns are not read as angles", Note, stacklevel=4)
            del unread[0]
        else:
            table.name_ignored(unread[0], unread)
            return rotations
    for family in unread:
        makers = [name for name in get_args(Maker) if family in (CHOSEN_ANGLES, ORDERS[name].names)]
        text = f"columns {listed(table.headings(family))} are not read, as makers order angles differently"
        makers += ["ur"] if family in RTDE else []
        warnings.warn(f"{source}: {text}; for orientations, set {KEY}: {', '.join(makers)}", Note, stacklevel=4)
    return None


def _rotations(table: PathTable, family: tuple[str, ...], order: AngleOrder, source: str) -> np.ndarray:
    units = {head.unit or order.unit for head in table.headings(family)}
    if units not in ({"deg"}, {"rad"}):
        raise InputError(f"{source}: the unit of {', '.join(family)} is {' and '.join(sorted(units))}; valid: deg, rad")
    angles = table.numbers(family)
    angles = np.radians(angles) if units == {"deg"} else angles
    import scipy  # here, as the schema of a job needs the makers' names and not this slow import

    rotation = scipy.spatial.transform.Rotation
    if order.axes == ROTATION_VECTOR:
        return rotation.from_rotvec(angles).as_matrix()
    return rotation.from_euler(order.axes, angles).as_matrix()
