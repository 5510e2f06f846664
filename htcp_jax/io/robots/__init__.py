"""Robots: reading of arms, and import of vendors' models as arms of capsules.

`load_robot` reads an arm from a model file, MJCF or URDF; `gp50` loads the built-in arm. `model_file` compiles such a
file with MuJoCo and extracts the chain to the TCP, see `chain`; `mujoco_models` compiles, and looks up names, texts and
numbers. `safe_xml` refuses harmful files before MuJoCo reads them.
`urdf_elements` finds unknown elements of a URDF, `ledger` counts and names what is not used, `urdf_joints` checks the
tree of a URDF and writes the ranges that hold; `remarks` turns what concerns the chain into messages. `joint_limits`
reads limits from another file, and `xacro_file` expands xacro files. `followers` finds the joints that follow others,
`constraints` the loops and tendons of an MJCF file, which are refused.

`model_source` has the types for the file or files of an arm or a cell, and `composed` reads several files as one tree.

`import_robot` converts a vendor's model, of an arm or of a cell in which the part moves, to an `ImportedArm`.
`capsule_fit` encloses each link's mesh in capsules; `close_fit` uses more capsules, within a tolerance. `stored_pieces`
has the convex pieces of the meshes in the capsules, `body_covers` all capsules of a body. `clear_share` finds the pairs
that need no check and how often the arm is clear; `closer_pieces` cuts pieces that overlap where their meshes do not.
`mjcf` writes an imported arm as a file for `load_robot`. `LinkMeshes` are the vendor's meshes within the capsules, for
contacts and distances between them. `attach` adds fixtures that move with a link to an arm.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
