"""Parts: workpieces with their paths, from files, from arrays, or generated.

A `WorkpieceSource` is the geometry: `GeneratedDuct`, `PointCloud`, `TriangleMesh` or `NoCloud`. `read_source` reads it
from a file, and `load_workpiece` makes the part from it, with its path and inlet. `load_geometry` reads only a cloud or
a mesh.

Modules of this package read tables, scans and CAD files. Libraries that are not written in Python parse a file in a
separate process with limits on time and memory. `load_workpiece` and `check_tool` refuse sizes that suggest a unit
other than metres.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
