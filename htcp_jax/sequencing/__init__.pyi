from .order import Order, check_solver, shortest_order
from .seam_plans import SeamPlans, Variants, not_joined, plan_seams
from .sequence import SeamSequence, find_sequence, whole_plans

__all__ = [
    "Order",
    "SeamPlans",
    "SeamSequence",
    "Variants",
    "check_solver",
    "find_sequence",
    "not_joined",
    "plan_seams",
    "shortest_order",
    "whole_plans",
]
