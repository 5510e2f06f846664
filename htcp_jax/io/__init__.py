"""Readers of robots, parts, paths, tables, XML and YAML, and the one reader and writer of files.

`files` limits the size of files and follows no link out of a folder, `safe_xml` and `strict_yaml` refuse harmful input,
`parsers` runs third-party parsers in a separate process. `robot_file.load_robot` reads an arm from MJCF or URDF,
`robot_import` fits capsules to a vendor's model, `workpiece_file.load_workpiece` reads a part with its path, `cell` the
bodies of a work cell.
"""
