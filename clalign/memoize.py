"""Remembering what a method has computed, for as long as its object lives."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def memoize(
    method: Callable[Concatenate[Owner, Arguments], Result],
) -> Callable[Concatenate[Owner, Arguments], Result]:
    """Compute each result of a method of hashable arguments once, and keep it in the object.

    `functools.lru_cache` keeps the objects themselves, with all that they hold, in a cache of the class.
    """
    name = f"_memoized_{method.__name__}"

    @wraps(method)
    def remembered(self: Owner, *arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        kept: dict[tuple[object, ...], Result] = vars(self).setdefault(name, {})
        key = (*arguments, *named.items())
        if key not in kept:
            kept[key] = method(self, *arguments, **named)
        return kept[key]

    return remembered
