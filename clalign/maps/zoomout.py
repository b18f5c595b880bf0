"""ZoomOut: the one loop by which maps grow in frequency (Melzi et al. 2019).

It lies below search and refinement, which both grow their maps by it, each with its own way to read point maps from a
functional map and to fit the next one, and with schedules that are data (`rules`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Functional = TypeVar("Functional")
Maps = TypeVar("Maps")
Step = TypeVar("Step")


def zoomout(
    schedule: Iterable[Step],
    read: Callable[[Functional, Maps | None, Step], Maps],
    fit: Callable[[Maps, Step], Functional],
    *,
    functional: Functional | None = None,
    maps: Maps | None = None,
) -> tuple[Functional, Maps]:
    """Alternate between point maps and functional maps.

    Parameters
    ----------
    schedule : sizes of the functional maps, or whatever else a step is described by.
    read : point maps from a functional map, the point maps of the step before (a guess, if any), and the step.
    fit : functional map of a step from point maps.
    functional : where to start, or ...
    maps : ... where to start, if without a functional map; with one, the guess of the first step.

    Returns
    -------
    The last functional map, and the point maps that it was fitted to.
    """
    for step in schedule:
        if functional is not None:
            maps = read(functional, maps, step)
        if maps is None:
            raise ValueError("zoomout starts from a functional map or from point maps")
        functional = fit(maps, step)
    if functional is None or maps is None:
        raise ValueError("a schedule of zoomout has at least one step")
    return functional, maps
