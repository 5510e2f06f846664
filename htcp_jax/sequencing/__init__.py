"""Sequencing: the order in which the seams of a job are done, from which configuration and in which direction.

`shortest_order` solves a generalised travelling-salesman problem with precedence, and returns an `Order` with a proven
lower bound. `cycle` finds a cycle of precedence. OR-Tools is needed, the extra "order".
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
