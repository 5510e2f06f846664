"""Robots: reading of arms, and import of vendors' models as arms of capsules.

`load_robot` reads an arm from a model file, MJCF or URDF; `gp50` is the built-in one. `model_file` compiles such a file
with MuJoCo and extracts the chain to the TCP. `safe_xml` refuses harmful files before MuJoCo reads them.

`import_robot` turns a vendor's model, of an arm or of a cell in which the part moves, into an `ImportedArm`:
`capsule_fit` encloses the mesh of each link in capsules, `close_fit` in more of them within a tolerance, and
`stored_pieces` are the convex pieces of the mesh in each.
`mjcf` writes such an arm as a file for `load_robot`. `LinkMeshes` are the vendor's meshes within the capsules, for
contacts and distances between them. `attached` adds fixtures that move with a link to an arm.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
