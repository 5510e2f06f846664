from .seam_plans import SeamPlans, Variants, not_joined, plan_seams
from .sequence import SeamSequence, find_sequence, whole_plans

__all__ = ["SeamPlans", "SeamSequence", "Variants", "find_sequence", "not_joined", "plan_seams", "whole_plans"]
