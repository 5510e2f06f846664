from . import arm_exclusion, bisection, branch_exclusion, exclusion, motion_bound, motion_proof, row_proof

__all__ = [
    "arm_exclusion",
    "bisection",
    "branch_exclusion",
    "exclusion",
    "motion_bound",
    "motion_proof",
    "row_proof",
]
