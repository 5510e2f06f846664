"""Decorators that cache results: by the identity of an object, or by the values of arguments."""

import pickle
import time
import weakref
from collections.abc import Callable
from functools import partial, wraps
from types import FunctionType
from typing import Any

from htcp_jax.caching import cache_folder

SLOW_S = 2e-4  # results that take longer to compute are stored in the cache folder, too; reading one takes as long
LARGEST = cache_folder.MOST_BYTES // 8  # maximum size of a stored result: a cloud of 3 million points has 120 MB
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


def cached_by_values(most: int) -> Callable[[FunctionType], Callable]:
    """Return a decorator for a function of the core. It caches the results by the values of the arguments.

    For example, a workpiece that is loaded twice is prepared once. Slow results are stored in the cache folder for
    other processes, if it is enabled. Callers share the results and must not change them.

    Args:
        most: Maximum number of results in memory; the least recently used ones are dropped.
    """

    def decorated(function: FunctionType) -> Callable:
        results: dict[str, Any] = {}

        @wraps(function)
        def result(*arguments: Any, **named: Any) -> Any:
            from htcp_jax.caching import cache_key  # here, as it imports JAX, and a job is read without JAX

            about, call = cache_key.described((arguments, named)), partial(function, *arguments, **named)
            return _last_used(results, repr(about), lambda: _stored_result(call, about), most)

        return result

    return decorated


def _stored_result(call: partial, about: tuple) -> Any:
    """Return the result of a call from the cache folder, or compute it, and store it if this takes over SLOW_S.

    Args:
        call: The function and its arguments.
        about: Description of the arguments.
    """
    from htcp_jax.caching import cache_key

    key = cache_key.result_key(call.func, about) if cache_folder.folder() else None
    if key is not None and (content := cache_folder.read(key)) is not None:
        try:
            return pickle.loads(content)
        except Exception:  # a damaged pickle raises exceptions of many types
            pass
    start_s = time.perf_counter()
    found = call()
    if key is not None and time.perf_counter() - start_s > SLOW_S:
        if len(content := pickle.dumps(found)) <= LARGEST:
            cache_folder.write(key, content)
    return found


def _last_used(results: dict, key: Any, compute: Callable[[], Any], most: int) -> Any:
    """Return the cached or else computed result for a key, and drop all but the `most` last used results."""
    found = results.pop(key, _MISSING)
    results[key] = found = compute() if found is _MISSING else found
    for oldest in list(results)[:-most]:
        results.pop(oldest, None)
    return found
