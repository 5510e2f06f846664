from . import cell, files, output_files, parts, robots, strict_model, strict_yaml

__all__ = [
    "cell",
    "files",
    "output_files",
    "parts",
    "robots",
    "strict_model",
    "strict_yaml",
]
