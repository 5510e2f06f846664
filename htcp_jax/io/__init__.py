"""Readers of robots, parts, work cells and YAML files, and functions that open and write files safely.

`robots` reads arms and imports vendors' models. `parts` reads workpieces with their paths. `cell` reads the bodies of a
work cell from an MJCF file.

`files` opens files: it limits their size, follows no link out of a folder, and writes files atomically. `output_files`
writes what a user names: whole folders, JSON and text, with one line on failure.
`strict_yaml` reads YAML and refuses harmful input. `strict_model` validates mappings; it refuses unknown keys and names
the valid ones.

Invalid input raises an InputError with one line that names the file and the valid choices.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
