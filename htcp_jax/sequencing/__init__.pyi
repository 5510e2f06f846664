from .order import Order, shortest_order
from .seam_plans import SeamPlans, Variants, not_joined, plan_seams
from .sequence import SeamSequence, find_sequence, whole_plans

__all__ = [
    "Order",
    "SeamPlans",
    "SeamSequence",
    "Variants",
    "find_sequence",
    "not_joined",
    "plan_seams",
    "shortest_order",
    "whole_plans",
]
