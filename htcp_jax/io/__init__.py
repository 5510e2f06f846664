"""Readers of robots, parts, paths, tables, XML and YAML, and the one reader and writer of files.

`files` limits the size of files and follows no link out of a folder; it alone opens files. `safe_xml` and `strict_yaml`
refuse harmful input, and `strict_model` checks mappings: a `strict_model.Section` refuses unknown keys and names the
valid ones. Point clouds are parsed in a separate process with limits.

`robot_file` reads an arm from MJCF or URDF; `robot_model` reads the model's numbers, `robot_import` fits capsules to a
vendor's model (`capsule_fit`), and `robot_xml` writes the arm as a file. `LinkMeshes` are the vendor's meshes within
the capsules. `workpiece_file` reads a part with its path, from one of its sources; `load_geometry` reads a cloud or a
mesh, `duct_seams` makes the seams of the generated duct, and `cell` reads the bodies of a work cell. `units` refuses
input whose size suggests another unit.

Bad input is an InputError of one line that names the file and the valid choices.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
