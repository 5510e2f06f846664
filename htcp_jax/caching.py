"""Cache of what is computed from one object, for as long as that object lives."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any


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
