"""Matches of one pair by several variants of the method, each computed when it is first asked for."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from clalign.benchmark.methods import own_method, uninterrupted
from clalign.correspondence import Correspondence
from clalign.errors import ClalignWarning
from clalign.evaluation.pairs import Problem

if TYPE_CHECKING:
    from clalign.geometry.cache import ShapeCache

Watch = Callable[[str], Callable[[str, float, str], None]]

#: What figures call the variants.
VARIANT_LABELS = {
    "default": "this program",
    "cycle": "with the cycle term",
    "isometric": "isometry enforced",
    "heat-kernel": "heat-kernel metric",
    "aligned": "no steps after the alignment",
    "mirrored": "from the mirror image",
    "one-sided": "one side only",
    "search-only": "search only",
    "paper": "as printed (Eq. 24)",
    "paper-searched": "as printed, from the search",
    "paper-mirrored": "as printed, other signs",
    "paper-cycle": "as printed, with the cycle term (Eq. 32)",
    "paper-isometric": "as printed, isometry enforced",
    "paper-heat-kernel": "as printed, heat-kernel metric",
}


def variant_label(name: str) -> str:
    """Return what figures call a variant."""
    return VARIANT_LABELS.get(name, name)


class VariantRuns:
    """The matches of one pair, by the names of `methods.method_names`.

    Parameters
    ----------
    problem : the pair.
    changes : options changed in every variant.
    cache : keeps what is computed of a single shape between the variants.
    watch : called with the name of a variant that is about to be matched; returns its progress callback.
    known : matches that are there already.
    """

    def __init__(
        self,
        problem: Problem,
        changes: Mapping[str, Any],
        *,
        cache: ShapeCache | None = None,
        watch: Watch | None = None,
        known: Mapping[str, Correspondence] | None = None,
    ) -> None:
        self.problem = problem
        self._changes = dict(changes)
        self._cache = cache
        self._watch = watch
        self._done = dict(known or {})

    def __call__(self, name: str) -> Correspondence:
        """Return the match by one variant.

        Its warnings are not raised, since a variant is expected to fail here and there; they are in the result.

        Raises
        ------
        OptionError
            No such variant, or a change that no option takes.
        """
        if name not in self._done:
            method = own_method(name, self._changes)
            progress = None if self._watch is None else self._watch(name)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ClalignWarning)
                self._done[name] = uninterrupted(method.correspondence(self.problem, self._cache, progress))
        return self._done[name]
