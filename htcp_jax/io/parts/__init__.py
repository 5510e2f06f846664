"""Parts: workpieces with their paths, from files, from arrays, or generated.

A `WorkpieceSource` states the geometry: `GeneratedDuct`, `PointCloud`, `TriangleMesh` or `NoCloud`; `read_source`
chooses one by a file's suffix, and `load_workpiece` makes the part from it, with its path and inlet. `load_geometry`
reads a cloud or a mesh alone. `SEAMS` are the paths of the generated duct that a job may name.

Tables, scans and CAD files are read by modules of this package; files that another library parses are parsed in a
separate process with limits. `check_tool` refuses a tool whose size suggests another unit than metres; all readers here
refuse such files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
