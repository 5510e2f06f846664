from . import cell, files, parts, robots, strict_model, strict_yaml

__all__ = [
    "cell",
    "files",
    "parts",
    "robots",
    "strict_model",
    "strict_yaml",
]
