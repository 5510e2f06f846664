"""Proofs about motions from anywhere: trajectories, program files, arrays.

`curves` makes joint paths from configurations: straight ones, polynomials, and all paths inside rounded corners.
`prove` proves or refutes them in the scene of a job or of a robot, which `scene` makes. `worst` measures where a
refuted motion collides, with which body, and how deep.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
