"""Parameters of the planning methods. The scene (robot, workpiece, start, margin) is not here.

The defaults are what works best; `configs/paper.yaml` holds the paper's choices.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, create_model

from htcp_jax.errors import InputError, described


def _could_be_a_solver(name: str) -> str:
    if name not in ("clarabel", "device") and not name.startswith("qpsolvers:"):
        raise InputError(f"{name!r} is not a QP solver; valid: clarabel, device, qpsolvers:<name of a solver>")
    return name


# Values beyond these are typing or unit errors: a target "reached" within a kilometre, a step of many turns.
SMALLEST = 1e-15  # smallest divisor and smallest step
Weight = Annotated[float, Field(ge=SMALLEST, le=1e6)]
Distance = Annotated[float, Field(ge=0, le=1)]  # [m]
Tolerance = Annotated[float, Field(ge=SMALLEST, le=0.1)]  # [m]
Angle = Annotated[float, Field(ge=SMALLEST, le=3)]  # [rad]
JointStep = Annotated[float, Field(gt=0, le=1e3)]  # [rad or m]
Steps = Annotated[int, Field(gt=0, le=10_000)]
Count = Annotated[int, Field(gt=0, le=100_000)]
Rounds = Annotated[int, Field(ge=0, le=100_000)]
Solver = Annotated[str, AfterValidator(_could_be_a_solver)]


@dataclass(frozen=True)
class Settings:
    """Constants of the planner; hashable, so it can be a static argument of a jitted function.

    Equation numbers are the paper's; where there is none, the value is a choice that the paper leaves open.

    Raises:
        InputError: For a value outside its range.
    """

    # Step QP, equation (9)
    q_weights: tuple[Weight, ...] = (5.0, 5.0, 2.0, 1.0, 5.0, 10.0)  # diagonal of Q, one weight per joint
    cost_about: Literal["reference", "previous"] = "reference"  # J1 about x_ref (9) or about x_{t-1} (4)
    clearance_rows: Literal["per-body", "smallest"] = "per-body"  # one row per body (8), or only the smallest D's (9)
    aim_above_m: Distance = 5e-4  # distance above the required margin at which the step QP's clearance rows aim
    max_step_qps: Steps = 20  # step QPs at one target before it counts as stuck
    tolerance_m: Tolerance = 1e-3  # a target is reached at this TCP error or less; also xi of the re-anchoring
    tolerance_rad: Annotated[float, Field(ge=SMALLEST, le=0.2)] = 2e-3  # and for the angles that the task constrains
    qp: Solver = "clarabel"  # solver: clarabel, device, or qpsolvers:<name>
    qp_tolerance: Annotated[float, Field(ge=SMALLEST, le=0.01)] = (
        1e-8  # of Clarabel's residuals and gap, no unit; at margin 0 it decides what gets stuck
    )

    # Null space, equations (10) and (11)
    alpha_rad: Angle = 0.1  # length of a null-space step, alpha in (11c)
    j1_weight: Annotated[float, Field(ge=0, le=1e6)] = 0.0  # of J1 in J2 = -D + J1, (5a) and (11a); the paper's is 1
    max_null_space_steps: Steps = 20  # null-space steps of one recovery
    include_proximal_bodies: bool = True  # True: J2 includes the capsules far from the workpiece
    # Where the optimisers start on the sphere; random_for_cmaes: CMA-ES alone at random, as in configs/paper.yaml
    first_direction: Literal["best_of_64", "random", "random_for_cmaes"] = "best_of_64"
    after_recovery: Literal["accept", "track"] = "accept"  # Algorithm 1 accepts; the prose tracks again

    # Between consecutive configurations
    path_check: Literal["none", "recoveries", "all"] = "all"  # segments that must be clear
    path_test: Literal["bisection", "samples"] = "bisection"  # a proof, or samples at the ends of `path_steps` steps
    path_steps: Steps = 20
    path_tolerance_m: Tolerance | None = None  # allowed TCP distance from the line between targets; None: the tolerance
    # Longest travel of a joint between two targets of the path, over all via points; one for all, or one per joint
    max_joint_step_rad: JointStep | tuple[JointStep, ...] | None = None  # [rad, of slides m]; None: no bound

    # Recovery by sampling
    samples: Count = 50  # configurations or directions tried at one stuck target
    sample_steps: Count = 100  # steps along one null-space direction
    sample_step_rad: Angle = 0.02  # length of each of them
    max_sample_distance_rad: Annotated[float, Field(ge=SMALLEST, le=1e3)] = 3.0  # longest joint jump of a sample

    # N-space CMA-ES
    population: Count = 100
    generations: Count = 5

    # Keep-clear: max-min null-space steps after each target while D is below a set clearance
    keep_clear_m: Distance = 0.02
    keep_clear_steps: Count = 5

    # Beam search
    beam_width: Count = 64  # beam width: most configurations kept at one target
    min_beam_width: Count = 16  # with fewer, the beam is widened by self-motions
    beam_separation_rad: Angle = 0.12  # closer configurations count as one
    beam_aim_m: Distance = 5e-3  # distance above the margin to which a configuration is moved, if possible
    self_motions: Count = 32  # self-motions in one round
    self_motion_steps: Steps = 12  # most steps of one self-motion
    self_motion_step_rad: Angle = 0.1  # length of each of them
    self_motion_rounds: Count = 12  # at a target without a successor
    # Configurations sampled or extended after a dead end, as a multiple of the search before; 0: none
    effort: Annotated[float, Field(ge=0, le=1e6)] = 2.0  # no unit
    transfers: bool = False  # True: the arm may change its configuration before the path, if that leads further

    # Complete path, equation (3)
    smooth: bool | None = None  # True: motions are smoothed; None: if the method requires it, as `beam` does
    path_weights: tuple[Weight, ...] | None = None  # joint weights in equation (3); None: 1 each, as in the paper

    # Connecting two configurations in free space: transfers, approaches
    search_rounds: Count = 1000  # sampling rounds before a pair of configurations counts as not connected
    search_step_rad: Angle = 0.3  # longest step that is proven at a time
    search_shortcuts: Rounds = 8  # rounds of shortcuts

    # Hybrid
    restart_rounds: Rounds = 9  # sampling rounds for a configuration at a failed target that leads back to the first

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  # every scenario's random key is folded from it

    @property
    def tube_m(self) -> float:
        """Allowed distance of a motion's TCP from the line between two targets [m]."""
        return self.tolerance_m if self.path_tolerance_m is None else self.path_tolerance_m

    def __post_init__(self):
        _checked(_RANGES, vars(self))


_RANGES = TypeAdapter(create_model("_Ranges", **{one.name: (one.type, ...) for one in fields(Settings)}))


def settings_of(values: Settings | Mapping[str, Any] | None) -> Settings:
    """Return the settings as they are; for a mapping, {"alpha_rad": 0.05}, the defaults with these values.

    None means the defaults.

    Raises:
        InputError: For an unknown name and for a value of the wrong type or outside its range.
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
    return _checked(TypeAdapter(Settings), values)


def _checked(kind: TypeAdapter, values: dict[str, Any]) -> Any:
    try:
        return kind.validate_python(values)
    except ValidationError as error:
        raise InputError(f"settings: {described(error.errors()[0])}") from None
