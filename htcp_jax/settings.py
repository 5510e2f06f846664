"""Every number and choice of the method. The scene (robot, workpiece, start, margin) is not here.

The defaults are what works best; `configs/paper.yaml` holds the paper's choices.
"""

import difflib
import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from htcp_jax.errors import InputError


@dataclass(frozen=True)
class Settings:
    """Constants of the planner; hashable, so it can be a static argument of a jitted function.

    Equation numbers are the paper's; where no equation stands, the value is a choice the paper leaves open.
    Raises InputError for a value outside its range.
    """

    # Step QP, equation (9)
    q_weights: tuple[float, ...] = (5.0, 5.0, 2.0, 1.0, 5.0, 10.0)  # diagonal of Q, one weight a joint
    cost_about: Literal["reference", "previous"] = "reference"  # J1 about x_ref (9) or about x_{t-1} (4)
    clearance_rows: Literal["per-body", "smallest"] = "per-body"  # a row a body (8), or that of the smallest D (9)
    aim_above_m: float = 5e-4  # how far above the margin that must be kept the step QP's clearance rows aim
    max_step_qps: int = 20  # step QPs at one target before it counts as stuck
    tolerance_m: float = 1e-3  # a target is reached at this TCP error or less; also xi of the re-anchoring
    tolerance_rad: float = 2e-3  # and of angles that the task holds
    qp: str = "clarabel"  # solver: clarabel, device, or qpsolvers:<name>
    qp_tolerance: float = 1e-8  # of Clarabel's residuals and gap, no unit; at margin 0 it decides what gets stuck

    # Null space, equations (10) and (11)
    alpha_rad: float = 0.1  # length of a null-space step, alpha in (11c)
    j1_weight: float = 0.0  # weight of J1 in J2 = -D + J1, (5a) and (11a); the paper's is 1
    max_null_space_steps: int = 20  # null-space steps of one escape
    include_proximal_bodies: bool = True  # whether J2 sees the capsules far from the workpiece
    # Where the optimisers start on the sphere; random_for_cmaes: CMA-ES alone at random, as in configs/paper.yaml
    first_direction: Literal["best_of_64", "random", "random_for_cmaes"] = "best_of_64"
    after_escape: Literal["accept", "track"] = "accept"  # Algorithm 1 accepts; the prose tracks again

    # Between consecutive configurations
    path_check: Literal["none", "escapes", "all"] = "all"  # which of them must be clear
    path_test: Literal["bisection", "samples"] = "bisection"  # by proof, or at the ends of `path_steps` equal steps
    path_steps: int = 20
    path_tolerance_m: float | None = None  # how far the TCP may leave the line between targets; None: the tolerance

    # Sampling escapes
    samples: int = 50  # configurations or directions tried at one stuck target
    sample_steps: int = 100  # steps along one null-space direction
    sample_step_rad: float = 0.02  # length of each of them
    max_sample_distance_rad: float = 3.0  # longest joint jump that a sample may ask for

    # N-space CMA-ES
    population: int = 100
    generations: int = 5

    # Keep-clear: max-min null-space steps after each target while D is below a set clearance
    keep_clear_m: float = 0.02
    keep_clear_steps: int = 5

    # Roadmap
    front: int = 64  # most postures kept at one target
    thin_front: int = 16  # with fewer, the front is spread by walks
    front_apart_rad: float = 0.12  # closer postures are one
    front_aim_m: float = 5e-3  # how far above the margin a posture is brought, where it can be
    walks: int = 32  # of one round
    walk_steps: int = 12  # the most of one walk
    walk_step_rad: float = 0.1  # length of each of them
    walk_rounds: int = 12  # at a target from which nothing leads on
    transfers: bool = False  # whether the arm may change its posture before the path, where that leads further

    # The whole path, equation (3)
    smooth: bool | None = None  # whether motions are smoothed; None: where the method asks for it, as roadmap does
    path_weights: tuple[float, ...] | None = None  # of the joints in equation (3); None: 1 each, as in the paper

    # Joining two postures in free space: transfers, approaches
    search_rounds: int = 1000  # of draws, before a pair of postures counts as not joined
    search_step_rad: float = 0.3  # longest step that is proven at a time
    search_shortcuts: int = 8  # rounds of them

    # Hybrid
    restart_rounds: int = 9  # rounds of draws for a posture at a lost target that leads back to the first

    seed: int = 0  # every scenario's random key is folded from it

    @property
    def tube_m(self) -> float:
        """How far the TCP of a motion may be from the line between two targets [m]."""
        return self.tolerance_m if self.path_tolerance_m is None else self.path_tolerance_m

    def __post_init__(self):
        for field in fields(self):
            _check(field.name, getattr(self, field.name), field.type)


def settings_of(values: Settings | Mapping[str, Any] | None) -> Settings:
    """Settings as they are; of a mapping, {"alpha_rad": 0.05}, the defaults with these values; of None, the defaults.

    Raises InputError for an unknown name and for a value of the wrong type or outside its range.
    """
    if isinstance(values, Settings):
        return values
    values = dict(values or {})
    known = [field.name for field in fields(Settings)]
    for name in values:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
            hint = f"did you mean {close[0]}?" if close else f"valid: {', '.join(known)}"
            raise InputError(f"settings: unknown key {name}; {hint}")
    try:
        return TypeAdapter(Settings).validate_python(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        text = f"{where} is {reprlib.repr(first['input'])}: {first['msg'][0].lower()}{first['msg'][1:]}"
        raise InputError(f"settings: {first.get('ctx', {}).get('error') or text}") from None


SMALLEST = 1e-15  # of any number but 0
MOST, LARGEST_SEED = 100_000, 2**63 - 1  # of whatever is counted; of the seed
_MAY_BE_ZERO = {
    "aim_above_m", "j1_weight", "keep_clear_m", "seed", "restart_rounds", "front_aim_m", "search_shortcuts",
}  # fmt: skip
# Beyond these a value is a slip of the pen or of the unit: a target "reached" within a kilometre, a step of many turns.
_AT_MOST = {
    "q_weights": 1e6, "j1_weight": 1e6, "tolerance_m": 0.1, "tolerance_rad": 0.2, "aim_above_m": 1.0,
    "keep_clear_m": 1.0, "path_tolerance_m": 0.1, "front_apart_rad": 3.0, "front_aim_m": 1.0, "walk_step_rad": 3.0,
    "walk_steps": 10_000, "search_step_rad": 3.0, "qp_tolerance": 0.01, "alpha_rad": 3.0, "sample_step_rad": 3.0,
    "max_sample_distance_rad": 1e3, "max_step_qps": 10_000, "max_null_space_steps": 10_000, "path_steps": 10_000,
    "seed": LARGEST_SEED,
}  # fmt: skip


def _check(name: str, value, kind) -> None:
    """Raise InputError unless `value` is in the range of the setting `name`."""
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise InputError(f"{name} is {value!r}; valid: {', '.join(get_args(kind))}")
    elif name == "qp":
        if value not in ("clarabel", "device") and not value.startswith("qpsolvers:"):
            raise InputError(f"qp is {value!r}; valid: clarabel, device, qpsolvers:<name of a solver>")
    elif not isinstance(value, bool | None):
        for number in value if isinstance(value, tuple) else (value,):
            if not math.isfinite(number) or number < 0 or (number == 0 and name not in _MAY_BE_ZERO):
                least = "zero or more" if name in _MAY_BE_ZERO else "more than zero"
                raise InputError(f"{name} must be {least} and finite, not {number}")
            if 0 < number < SMALLEST:
                raise InputError(f"{name} is {number}; at least {SMALLEST:g}")
            if number > (most := _AT_MOST.get(name, MOST)):
                raise InputError(f"{name} is {number}; at most {most}")
