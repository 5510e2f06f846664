from . import arrays, cell, parts, robots

__all__ = [
    "arrays",
    "cell",
    "parts",
    "robots",
]
