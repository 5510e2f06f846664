"""Placement optimisation: ranges of a job's parameters, and the mountings in them that complete the path, ranked.

A mounting is a value for each parameter that varies, such as the workpiece's pose. `place` runs a search: it reads a
file of ranges, proposes mountings, plans each of them, and plans the best ones again under perturbation. It reports its
progress as `PlaceProgress`, writes its results into a folder, and returns them as a `PlacementResult`.

`ranges` contains the parameters that vary, with bounds and units; `mounting` a mounting with its objectives and
tolerance; `tolerance` the tested levels of perturbation.

A search plans by `runs.sweep`, so an interrupted search can be resumed.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
