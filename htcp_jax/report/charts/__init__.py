"""Charts of sweep results. Every function returns a matplotlib Figure; a notebook displays it.

Arguments are mappings from method to array, S scenarios by T targets, as in `Plans`:

    charts.survival({"baseline": plans_a.status, "nspace-sqp": plans_b.status})

A status below zero marks a target that does not exist or a scenario that is not planned yet. Colours are
distinguishable for colour-blind readers and never the only distinction: methods also differ in line style, each line
has its method's name, reasons of failure differ in marker, and a map's cells contain numbers. Drawing needs no screen.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
