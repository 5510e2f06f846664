"""Placement optimisation: ranges of a job's parameters, and the mountings in them that complete the path, ranked.

`place` runs a search: it reads a file of ranges, proposes mountings, plans each of them, and plans the best ones again
under perturbation. While it runs it reports a `PlaceProgress`; its result, which is also its folder on disk, is
`PlacementResult`.

`ranges` are the parameters that vary, with their bounds and units. `mounting` has one mounting with its score and
tolerance, and what a search may maximise. `tolerance` has the levels of perturbation that are tried.

A search plans by `runs.sweep`, so an interrupted one continues where it stopped.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
