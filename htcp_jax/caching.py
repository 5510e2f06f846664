"""Decorators that cache results: by the identity of an object, or by the values of an array."""

import hashlib
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

_MISSING = object()


def cached_for_last(most: int) -> Callable[[Callable], Callable]:
    """Return a decorator for a function of one object. It caches the results by the object's identity.

    A result is freed when its object is freed.

    Args:
        most: Maximum number of cached results; the least recently used ones are dropped.
    """

    def decorated(function: Callable) -> Callable:
        results: dict[weakref.ref, Any] = {}

        @wraps(function)
        def result(owner: Any) -> Any:
            key = weakref.ref(owner, lambda gone: results.pop(gone, None))
            return _last_used(results, key, lambda: function(owner), most)

        return result

    return decorated


def cached_by_values(most: int) -> Callable[[Callable], Callable]:
    """Return a decorator for a function of an array and of hashable arguments. It caches the results by their values.

    For example, a workpiece that is loaded twice is prepared once. Callers share the results and must not change them.

    Args:
        most: Maximum number of cached results; the least recently used ones are dropped.
    """

    def decorated(function: Callable) -> Callable:
        results: dict[tuple, Any] = {}

        @wraps(function)
        def result(array: np.ndarray, *others: Any) -> Any:
            values = hashlib.blake2b(np.ascontiguousarray(array)).digest()
            key = values, array.shape, array.dtype.str, *others
            return _last_used(results, key, lambda: function(array, *others), most)

        return result

    return decorated


def _last_used(results: dict, key: Any, compute: Callable[[], Any], most: int) -> Any:
    """Return the cached or else computed result for a key, and drop all but the `most` last used results."""
    found = results.pop(key, _MISSING)
    results[key] = found = compute() if found is _MISSING else found
    for oldest in list(results)[:-most]:
        results.pop(oldest, None)
    return found
