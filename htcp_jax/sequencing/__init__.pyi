from .order import Order, cycle, shortest_order

__all__ = [
    "Order",
    "cycle",
    "shortest_order",
]
