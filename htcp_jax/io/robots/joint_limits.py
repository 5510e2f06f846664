"""Joint limits from a file in the format of MoveIt's and ros2_control's joint_limits.yaml.

```python
stated = read_joint_limits("joint_limits.yaml", robot.joint_names, robot.name)
lower, upper = stated.ranges(robot.slides, lower, upper)  # ranges of an arm whose model states lower and upper
```

A limit in the file replaces the model's, also if it is wider. Where the file states none, the model's applies.
"""

import math
import re
import reprlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.spec import LIMITS_FILE, Quantity, is_limits_file, parse_mapping, yaml_text

SECTION = "joint_limits"
RATES = "velocity", "acceleration", "jerk"
# Keys of each kind of limit.
BOUNDS = {"position": ("min_position", "max_position")} | {rate: (f"max_{rate}",) for rate in RATES}
SWITCHES = tuple(f"has_{kind}_limits" for kind in (*BOUNDS, "effort", "deceleration"))  # not named as unused
LARGEST_ANGLE, LARGEST_SHIFT = 20.0, 100.0  # larger positions [rad, m] are usually in degrees or millimetres
FASTEST = 50.0  # larger velocities [rad/s, m/s] are named, as they may be in degrees per second
MOST = 8  # largest number of names in a list of a message
UNLIMITED = 1e6  # larger positions stand for no limit [rad or m]
LIMIT_ROUNDING = 1e-6  # difference from a limit that is not reported [rad or m, per s]
# Angles as rosparam reads them.
ANGLE = re.compile(r"\s*(deg|rad)\(\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*\)\s*")
ANGLE_TAGS = {"deg": "!degrees", "rad": "!radians"}


class StatedLimits(NamedTuple):
    """Limits of one joint in a file; None where the file states none."""

    lower: float | None = None  # [rad or m]
    upper: float | None = None  # [rad or m]
    velocity: float | None = None  # [rad/s or m/s]
    acceleration: float | None = None  # [rad/s2 or m/s2]
    jerk: float | None = None  # [rad/s3 or m/s3]

    @property
    def ranged(self) -> bool:
        """True if the file states at least one end of the joint's range."""
        return self.lower is not None or self.upper is not None


class JointLimits(NamedTuple):
    """Limits of an arm's N joints in a file."""

    file: str  # its name, for messages
    names: tuple[str, ...]  # the arm's joints
    stated: tuple[StatedLimits, ...]  # of each joint
    missing: tuple[str, ...]  # joints of the arm that are not listed
    others: tuple[str, ...]  # listed joints that the arm does not have
    unused: tuple[str, ...]  # elements of the file without effect
    is_cut: bool  # True if the last line has no line end

    def ranges(
        self, slides: Sequence[bool], lower: Float[np.ndarray, "N"], upper: Float[np.ndarray, "N"]
    ) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
        """Return the joints' ranges: the file's where it states them, else the model's [rad or m].

        Args:
            slides: True for prismatic joints.
            lower: Lower ends of the model's ranges [rad or m], -inf for no limit.
            upper: Upper ends of the model's ranges [rad or m], inf for no limit.

        Raises:
            InputError: If a range does not ascend, if a position seems to be in degrees or millimetres, and for angles
                of a prismatic joint or lengths of another one.
        """
        bounds = np.stack([lower, upper], axis=1).astype(float)
        for own, name, stated, slide in zip(bounds, self.names, self.stated, slides, strict=True):
            self._check_units(name, stated, slide)
            farthest = float(np.abs(own).max())
            for side, value in enumerate((stated.lower, stated.upper)):
                if value is not None:
                    own[side] = self._position(name, side, value, slide, farthest)
            if not own[0] < own[1]:
                raise InputError(
                    f"{self.file}: joint {name} has range {own[0]:g} to {own[1]:g}; min_position must be less than "
                    "max_position"
                )
        return bounds[:, 0], bounds[:, 1]

    def _check_units(self, joint: str, stated: StatedLimits, slide: bool) -> None:
        given = [value for value in stated if isinstance(value, Quantity)]
        if any(value.is_angle == slide for value in given):
            wrong, right = ("degrees or radians", "m") if slide else ("lengths", "rad")
            raise InputError(f"{self.file}: limits of joint {joint} are {wrong}, but it moves in {right}")

    def _position(self, joint: str, side: int, value: float, slide: bool, farthest: float) -> float:
        """Return one end of a range; infinite for hinges beyond `UNLIMITED`.

        Raises:
            InputError: If the position is not plausible, and farther out than the model's `farthest` limit.
        """
        if math.isinf(value) or (abs(value) > UNLIMITED and not slide):
            return math.copysign(math.inf, value)
        largest = LARGEST_SHIFT if slide else LARGEST_ANGLE
        if abs(value) > largest and not (math.isfinite(farthest) and abs(value) <= farthest + LIMIT_ROUNDING):
            unit, wrong = ("m", "millimetres") if slide else ("rad", "degrees")
            remedy = f"write {1e-3 * value:g}" if slide else f"write !degrees {value:g}, or {math.radians(value):.6g}"
            key = BOUNDS["position"][side]
            raise InputError(
                f"{self.file}: {key} of joint {joint} is {value:g} {unit}, which seems to be in {wrong}; {remedy}"
            )
        return value

    def rates(self, kind: str) -> Float[np.ndarray, "N"]:
        """Return the limits of a kind in `RATES` [rad or m, per s, s2 or s3]; NaN for joints without one."""
        given = [getattr(stated, kind) for stated in self.stated]
        return np.array([math.nan if value is None else value for value in given])

    def note(
        self,
        ranges: tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]] | None = None,
        speed: Float[np.ndarray, "N"] | None = None,
    ) -> str | None:
        """Return one line that names elements without effect and limits that remain the model's; None if none.

        Args:
            ranges: The model's lower and upper limits [rad or m] if the file's replace them; None: they do not.
            speed: The model's velocity limits [rad/s or m/s] if the file's replace them; None: they do not.
        """
        listed = [name for name in self.names if name not in self.missing]
        without = [name for name, own in zip(self.names, self.stated, strict=True) if name in listed and not own.ranged]
        parts = {
            "wider than the model: ": [] if ranges is None else list(self._wider(*ranges)),
            "faster than the model: ": [] if speed is None else list(self._faster(speed)),
            "the model's ranges apply to ": [] if ranges is None else without,
            "all limits of the model apply to ": self.missing,
            "not joints of the arm: ": self.others,
            "not used: ": self.unused,
        }
        found = [f"{text}{_list(names)}" for text, names in parts.items() if names]
        if (fastest := float(np.nan_to_num(self.rates("velocity")).max())) > FASTEST:
            found.append(f"velocities are up to {fastest:g}; write !degrees {fastest:g} if they are in degrees")
        if self.is_cut:
            found.append("the last line has no line end; check that the file is complete")
        return " ".join(f"{self.file}: {'; '.join(found)}".split()) if found else None

    def _wider(self, lower: np.ndarray, upper: np.ndarray) -> Iterator[str]:
        """Yield the joints whose ranges are wider than the model's, with both ranges."""
        for name, own, low, high in zip(self.names, self.stated, lower.tolist(), upper.tolist(), strict=True):
            below, above = low if own.lower is None else own.lower, high if own.upper is None else own.upper
            if below < low - LIMIT_ROUNDING or above > high + LIMIT_ROUNDING:
                yield f"{name} {below:g} to {above:g} (the model's: {low:g} to {high:g})"

    def _faster(self, speed: np.ndarray) -> Iterator[str]:
        """Yield the joints whose velocity limits are larger than the model's, with both."""
        for name, own, known in zip(self.names, self.rates("velocity").tolist(), speed.tolist(), strict=True):
            if own > known + LIMIT_ROUNDING:
                yield f"{name} {own:g} (the model's: {known:g})"


def read_joint_limits(path: str | Path, names: Sequence[str], arm: str) -> JointLimits:
    """Read the limits of an arm's joints from a file.

    The section `joint_limits` lists joints by name, each with `min_position`, `max_position`, `max_velocity`,
    `max_acceleration` and `max_jerk` [rad or m, per s, s2, s3]. `has_position_limits: false`, and so on, switches a
    limit off. The section may be inside others, such as a ROS 2 node's `ros__parameters`. Angles may have a unit:
    `!degrees 180`, `deg(180)`.

    Args:
        path: The file.
        names: Names of the arm's N joints.
        arm: Name of the arm, for messages.

    Raises:
        InputError: If the file has another ending than those in `choices.LIMITS_ENDINGS`, cannot be read, is not YAML,
            has another format, or limits none of the joints. For a joint of the arm: if a switch is not true or
            false, a limit is switched on but missing, a position is not a number, or another limit is not positive.
    """
    file = str(path)
    if not is_limits_file(path):
        raise InputError(f"{file} is not a file with joint limits; valid: {LIMITS_FILE}")
    text = yaml_text(path)
    section, unused = _section(parse_mapping(text, file, units=True), file)
    section = {str(name): entry for name, entry in section.items()}  # YAML also has numbers as keys
    own = {name: section[name] for name in names if name in section}
    if not own:
        raise InputError(f"{file}: no joint of {arm} is listed; valid: {', '.join(names)}")
    for name in (name for name, entry in own.items() if not isinstance(entry, dict)):
        raise InputError(f"{file}: joint {name} must be a mapping, such as {{max_velocity: 2.0}}")
    stated = tuple(_stated(own.get(name, {}), file, name) for name in names)
    if all(each == StatedLimits() for each in stated):
        raise InputError(
            f"{file} limits no joint of {arm}; add min_position and max_position, max_velocity, max_acceleration or "
            "max_jerk"
        )
    missing = tuple(name for name in names if name not in own)
    others = tuple(name for name in section if name not in own)
    is_cut = not text.endswith(("\n", "}"))
    return JointLimits(file, tuple(names), stated, missing, others, (*unused, *_unused_keys(own)), is_cut)


def _section(raw: dict, file: str) -> tuple[dict[str, Any], list[str]]:
    """Return the section of the joints, and the names of the keys next to it and to the sections that contain it.

    Raises:
        InputError: If there is no such section, or more than one.
    """
    found = list(_sections(raw, ()))
    if len(found) > 1:
        raise InputError(f"{file}: {SECTION} occurs {len(found)} times; keep one")
    if not found:
        raise InputError(f"{file}: the mapping {SECTION} is missing, as in MoveIt's joint_limits.yaml")
    unused: list[str] = []
    for key in (*found[0], SECTION):
        unused += [str(other) for other in raw if other != key]
        raw = raw[key]
    return raw, unused


def _sections(raw: dict, above: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield the keys of the sections that contain a section of joints."""
    for key, value in raw.items():
        if isinstance(value, dict):
            if key == SECTION:
                yield above
            else:
                yield from _sections(value, (*above, key))


def _stated(entry: dict[str, Any], file: str, joint: str) -> StatedLimits:
    """Return the limits in a joint's entry.

    Raises:
        InputError: See `read_joint_limits`.
    """
    found: list[float | None] = []
    for kind, keys in BOUNDS.items():
        switch = f"has_{kind}_limits"
        is_on = entry.get(switch)
        if is_on is not None and not isinstance(is_on, bool):
            raise InputError(f"{file}: {switch} of joint {joint} is {reprlib.repr(is_on)}; valid: true, false")
        if is_on and (missing := [key for key in keys if key not in entry]):
            raise InputError(f"{file}: {switch} of joint {joint} is true, but {missing[0]} is missing")
        for key in keys:
            off = is_on is False or key not in entry
            found.append(None if off else _number(entry[key], file, key, joint))
    return StatedLimits(*found)


def _number(value: Any, file: str, key: str, joint: str) -> float:
    """Return a limit as a number [rad or m, per s, s2 or s3].

    Raises:
        InputError: If it is not a number, or if it is a rate that is not positive and finite.
    """
    if isinstance(value, str) and (angle := ANGLE.fullmatch(value)):
        value = Quantity.of(ANGLE_TAGS[angle[1]], float(angle[2]))
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    number = value if isinstance(value, Quantity) else float(value) if is_number else math.nan
    if key in BOUNDS["position"]:
        if math.isnan(number):
            raise InputError(
                f"{file}: {key} of joint {joint} is {reprlib.repr(value)}; write a number, or such as !degrees 180"
            )
    elif not 0 < number < math.inf:
        raise InputError(f"{file}: {key} of joint {joint} is {reprlib.repr(value)}; it must be a positive number")
    return number


def _unused_keys(section: dict[str, dict[str, Any]]) -> list[str]:
    """Return the keys in the joints' entries that have no effect, each with its joints."""
    found: dict[str, list[str]] = {}
    for joint, entry in section.items():
        off = {key for kind, keys in BOUNDS.items() if entry.get(f"has_{kind}_limits") is False for key in keys}
        for key, value in entry.items():
            known = key in SWITCHES or (key not in off and any(key in keys for keys in BOUNDS.values()))
            if not known and not (key in off and not value):
                found.setdefault(key, []).append(joint)
    return [f"{key} of {_list(joints)}" for key, joints in found.items()]


def _list(names: Sequence[str]) -> str:
    """Return names as text; after `MOST` of them only the number of the others."""
    more = len(names) - MOST
    return ", ".join(names[:MOST]) + (f" and {more} more" if more > 0 else "")
