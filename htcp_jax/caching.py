"""Caches of what is computed from one object, for as long as it lives, or from an array, by its values."""

import hashlib
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np


def cached_for_last(most: int) -> Callable[[Callable], Callable]:
    """Return a decorator that caches a function of one object by the object's identity.

    Each result belongs to its object and is freed with it; at most the `most` last used ones are kept.
    """

    def decorated(function: Callable) -> Callable:
        results: dict[weakref.ref, Any] = {}

        @wraps(function)
        def result(owner: Any) -> Any:
            key = weakref.ref(owner, lambda gone: results.pop(gone, None))
            found = results.pop(key) if key in results else function(owner)
            results[key] = found  # the last one
            for oldest in list(results)[:-most]:
                results.pop(oldest, None)
            return found

        return result

    return decorated


def cached_by_values(most: int) -> Callable[[Callable], Callable]:
    """Return a decorator that caches a function of one array and further hashable arguments by their values.

    A part that is loaded again is not prepared again. The `most` last used results are kept; callers share them and
    must not change them.
    """

    def decorated(function: Callable) -> Callable:
        results: dict[tuple, Any] = {}

        @wraps(function)
        def result(array: np.ndarray, *others: Any) -> Any:
            values = hashlib.blake2b(np.ascontiguousarray(array)).digest()
            key = values, array.shape, array.dtype.str, *others
            found = results.pop(key, None)
            results[key] = found = function(array, *others) if found is None else found  # the last one
            for oldest in list(results)[:-most]:
                results.pop(oldest, None)
            return found

        return result

    return decorated
