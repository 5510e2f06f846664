from . import bisection, branch_exclusion, exclusion, motion_bound, motion_proof, row_proof

__all__ = [
    "bisection",
    "branch_exclusion",
    "exclusion",
    "motion_bound",
    "motion_proof",
    "row_proof",
]
