"""Charts of sweep results, in one style. Every function returns a matplotlib Figure; a notebook displays it.

Results come as a mapping from method to array, S scenarios by T targets, as in `Plans`:

    charts.survival({"baseline": plans_a.status, "nspace-sqp": plans_b.status})

A status below zero marks a target that does not exist or a scenario that is not planned yet. Colours are
distinguishable for colour-blind readers and never carry a meaning alone: methods also differ in line style, and each
line has its name; reasons differ in marker; the cells of a map show their number. Drawing needs no screen.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
