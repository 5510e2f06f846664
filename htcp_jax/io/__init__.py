"""Readers of robots, parts and work cells.

`robots` reads arms and imports vendors' models. `parts` reads workpieces with their paths. `load_cell` reads the bodies
of a work cell from an MJCF file. `motions` reads joint motions and robot programs. `arrays` reads .npy, .npz and
Parquet files, which may be untrusted.

Invalid input raises an InputError with one line that names the file and the valid choices.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
