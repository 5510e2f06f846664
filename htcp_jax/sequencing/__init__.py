"""Sequencing: the order of a part's seams, the direction of each, and the proven motion through all of them.

`plan_seams` plans each seam in several ways, `find_sequence` orders them by `shortest_order` and proves the air moves
between them, and `whole_plans` is the plan of the whole motion.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
