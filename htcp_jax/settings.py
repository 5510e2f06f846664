"""Parameters of the planning methods. Robot, workpiece, start and margin are not part of them, but of the job.

The defaults worked best in our tests; `Settings.paper()` are the paper's values.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, create_model

from htcp_jax.errors import InputError, described, did_you_mean


def _could_be_a_solver(name: str) -> str:
    if name not in (AUTO_QP, "clarabel", "device") and not name.startswith("qpsolvers:"):
        raise InputError(f"{name!r} is not a QP solver; valid: auto, clarabel, device, qpsolvers:<name of a solver>")
    return name


AUTO_QP = "auto"  # value of `Settings.qp` that `Settings.on` replaces

# Valid ranges. A value outside its range is a typing error or has the wrong unit.
SMALLEST = 1e-15  # smallest divisor and smallest step
Weight = Annotated[float, Field(ge=SMALLEST, le=1e15)]
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
    """Parameters of the planner. Instances are hashable: they can be static arguments of jitted functions.

    Equation numbers refer to the paper. The paper does not specify parameters without an equation number.

    Raises:
        InputError: For a value outside its range.
    """

    # Step QP, equation (9)
    q_weights: tuple[Weight, ...] = (5.0, 5.0, 2.0, 1.0, 5.0, 10.0)  # diagonal of Q, one weight per joint
    cost_about: Literal["reference", "previous"] = "reference"  # centre of J1: x_ref (9) or x_{t-1} (4)
    clearance_rows: Literal["per-body", "smallest"] = "per-body"  # one row per body (8), or only the smallest D's (9)
    aim_above_m: Distance = 5e-4  # distance above the required margin at which the step QP's clearance rows aim
    max_step_qps: Steps = 20  # maximum number of step QPs at one target; the arm then counts as stuck
    tolerance_m: Tolerance = 1e-3  # maximum TCP error at a reached target; also xi, the tolerance of re-anchoring
    tolerance_rad: Annotated[float, Field(ge=SMALLEST, le=0.2)] = 2e-3  # maximum error of the constrained angles
    qp: Solver = AUTO_QP  # solver: clarabel, device, qpsolvers:<name>, or auto: clarabel on a CPU, device on a GPU
    qp_tolerance: Annotated[float, Field(ge=SMALLEST, le=0.01)] = (
        1e-8  # Clarabel's tolerance for residuals and gap [1]; at margin 0 it decides which targets get stuck
    )

    # Null space, equations (10) and (11)
    alpha_rad: Angle = 0.1  # length of a null-space step, alpha in (11c)
    j1_weight: Annotated[float, Field(ge=0, le=1e6)] = 0.0  # of J1 in J2 = -D + J1, (5a), (11a); 1 in the paper
    max_null_space_steps: Steps = 20  # maximum number of null-space steps in one recovery
    include_proximal_bodies: bool = True  # True: J2 includes the capsules far from the workpiece
    # Initial direction of the optimisers; best_of_64: of 64 spread directions; random_for_cmaes: random for CMA-ES only
    first_direction: Literal["best_of_64", "random", "random_for_cmaes"] = "best_of_64"
    # accept: use the recovery's configuration, as Algorithm 1; track: continue with step QPs, as the paper's text
    after_recovery: Literal["accept", "track"] = "accept"

    # Between consecutive configurations
    path_check: Literal["none", "recoveries", "all"] = "all"  # segments that are checked for collisions
    path_test: Literal["bisection", "samples"] = "bisection"  # bisection: a proof; samples: checks at samples
    path_steps: Steps = 20  # number of equal steps between the samples of a segment
    path_tolerance_m: Tolerance | None = None  # allowed TCP distance from the line between targets; None: the tolerance
    # Maximum travel of a joint between two targets of the path, summed over via points: one value, or one per joint
    max_joint_step_rad: JointStep | tuple[JointStep, ...] | None = None  # [rad; prismatic joints m]; None: no bound

    # Recovery by sampling
    samples: Count = 50  # configurations or directions tried at one stuck target
    sample_steps: Count = 100  # steps along one null-space direction
    sample_step_rad: Angle = 0.02  # length of one such step
    max_sample_distance_rad: Annotated[float, Field(ge=SMALLEST, le=1e3)] = 3.0  # longest joint jump of a sample

    # N-space CMA-ES
    population: Count = 100  # number of directions in one generation
    generations: Count = 5

    # Keep-clear: null-space steps at a target that increase the minimum clearance D
    keep_clear_m: Distance = 0.02  # the steps are taken if D is below this
    keep_clear_steps: Count = 5  # maximum number of steps per target

    # Beam search
    beam_width: Count = 64  # maximum number of configurations kept at one target
    min_beam_width: Count = 16  # a beam with fewer configurations is widened by self-motions
    beam_separation_rad: Angle = 0.12  # configurations closer than this count as one
    beam_aim_m: Distance = 5e-3  # distance above the margin to which a configuration is moved, if possible
    self_motions: Count = 32  # number of self-motions in one round
    self_motion_steps: Steps = 12  # maximum number of steps in one self-motion
    self_motion_step_rad: Angle = 0.1  # length of one step of a self-motion
    self_motion_rounds: Count = 12  # maximum number of rounds if no configuration reaches the next target
    # Maximum number of configurations sampled or extended after a dead end, as a multiple of the number before it; 0:
    # the plan ends at the first dead end
    effort: Annotated[float, Field(ge=0, le=1e6)] = 2.0  # no unit
    transfers: bool = False  # True: the arm may change its configuration before the path, if that leads further

    # Complete path, equation (3)
    smooth: bool | None = None  # True: motions are smoothed; None: only if the method requires it, as `beam` does
    path_weights: tuple[Weight, ...] | None = None  # joint weights in equation (3); None: 1 each, as in the paper

    # Connecting two configurations in free space: transfers, approaches
    search_rounds: Count = 1000  # sampling rounds before a pair of configurations counts as not connected
    search_step_rad: Angle = 0.3  # maximum length of one proven step
    search_shortcuts: Rounds = 8  # number of rounds of shortcuts on a found path

    # Hybrid: sampling rounds for a configuration at the failed target that can be planned back to the first target
    restart_rounds: Rounds = 9

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  # every scenario's random key is derived from it

    @classmethod
    def paper(cls, joints: int = 6) -> "Settings":
        """Return the paper's values, which `configs/paper.yaml` explains: `j1_weight` is 1, and Q has equal weights.

        The paper's margin of 0 belongs to the scenario: `make_scenario(..., margin_m=0.0)`.

        Args:
            joints: Number of the arm's joints.
        """
        return cls(
            q_weights=(1.0,) * joints,
            cost_about="previous",
            clearance_rows="smallest",
            aim_above_m=0.0,
            j1_weight=1.0,
            first_direction="random_for_cmaes",
            path_check="none",
            path_test="samples",
        )

    @classmethod
    def port(cls) -> "Settings":
        """Return the paper's values with the authors' C++ port's Q, as `configs/port.yaml`, for an arm of 6 joints."""
        return replace(cls.paper(), q_weights=cls.q_weights, first_direction=cls.first_direction)

    @property
    def tube_m(self) -> float:
        """Allowed distance of a motion's TCP from the line between two targets [m]."""
        return self.tolerance_m if self.path_tolerance_m is None else self.path_tolerance_m

    def on(self, platform: str) -> "Settings":
        """Return the settings with the QP solver that `auto` selects on a platform, such as "cpu"; results name it."""
        return replace(self, qp="clarabel" if platform == "cpu" else "device") if self.qp == AUTO_QP else self

    def __post_init__(self):
        _checked(_RANGES, vars(self))


_RANGES = TypeAdapter(create_model("_Ranges", **{one.name: (one.type, ...) for one in fields(Settings)}))


def settings_of(values: Settings | Mapping[str, Any] | None) -> Settings:
    """Return the `Settings` with the given values, such as {"alpha_rad": 0.05}, and defaults for all others.

    Args:
        values: Values by name; None: only defaults. `Settings` are returned unchanged.

    Raises:
        InputError: For an unknown name, or a value that has the wrong type or is outside its range.
    """
    if isinstance(values, Settings):
        return values
    values = dict(values or {})
    known = [field.name for field in fields(Settings)]
    for name in values:
        if name not in known:
            hint = did_you_mean(str(name), known).rstrip() or f"valid: {', '.join(known)}"
            raise InputError(f"settings: unknown key {name}; {hint}")
    return _checked(TypeAdapter(Settings), values)


def _checked(kind: TypeAdapter, values: dict[str, Any]) -> Any:
    try:
        return kind.validate_python(values)
    except ValidationError as error:
        raise InputError(f"settings: {described(error.errors()[0])}") from None
