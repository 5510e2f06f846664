from . import cache_folder, cache_key
from .cache_key import preparation_key, program_key, source_key
from .decorators import cached_by_values, cached_for_last

__all__ = [
    "cache_folder",
    "cache_key",
    "cached_by_values",
    "cached_for_last",
    "preparation_key",
    "program_key",
    "source_key",
]
