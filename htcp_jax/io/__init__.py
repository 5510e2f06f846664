"""Readers of robots, parts, cells and YAML, and the one reader and writer of files.

`robots` reads arms and imports vendors' models; `parts` reads workpieces with their paths. `cell` reads the bodies of a
work cell from an MJCF file.

`files` alone opens files: it limits their size, follows no link out of a folder, and replaces a file completely or not
at all. `strict_yaml` refuses harmful input, and `strict_model` checks mappings: a `strict_model.FileSection` refuses
unknown keys and names the valid ones.

Bad input is an InputError of one line that names the file and the valid choices.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
