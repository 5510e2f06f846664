from . import arm_exclusion, bisection, exclusion, motion_bound, motion_proof, row_proof

__all__ = [
    "arm_exclusion",
    "bisection",
    "exclusion",
    "motion_bound",
    "motion_proof",
    "row_proof",
]
