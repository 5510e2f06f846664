from .order import Order, check_solver, shortest_order
from .seam_plans import SeamPlans, Variants, not_joined, plan_seams
from .sequence import ORDER_EFFORT, SeamSequence, find_sequence, moves_between, whole_plans

__all__ = [
    "ORDER_EFFORT",
    "Order",
    "SeamPlans",
    "SeamSequence",
    "Variants",
    "check_solver",
    "find_sequence",
    "moves_between",
    "not_joined",
    "plan_seams",
    "shortest_order",
    "whole_plans",
]
