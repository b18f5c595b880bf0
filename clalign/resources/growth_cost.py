"""How many operations the growing of maps takes, counted from the steps that `pieces` and `refine` make."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clalign.options import Options
from clalign.rules import RefinementRules

_R = RefinementRules()
GENERATIONS, GROWN, LIMIT, LOW_REGROWTH, REGROWTH, SETTLING, GROWTHS, UP_SAMPLING_QUERIES, SAMPLES = (
    _R.generations,
    _R.grown,
    _R.compared,
    _R.regrow_low,
    _R.regrow,
    _R.settle,
    _R.schedules,
    1000,
    1000,
)

if TYPE_CHECKING:
    from clalign.resources.forecast import Sizes

SEARCHED = 30
"""Functions of the map that the search gives to growths that keep all of them; it depends on the pair."""
WAVELET_STEPS = 2


def pieces_are_grown(options: Options) -> bool:
    """Tell whether a match grows several maps and takes the best of each piece."""
    return options.search.method != "random" and options.readout.refine == "patches"


def growth_operations(size: Sizes, options: Options) -> tuple[float, float]:
    """Return floating-point operations on the device and those of small dense algebra, for the map and its rivals."""
    if options.search.method == "random" or options.readout.refine == "none":
        return 0.0, 0.0
    piecewise = pieces_are_grown(options)
    largest = min(size.functions, GROWN) if piecewise else size.functions
    queries = min(size.samples, UP_SAMPLING_QUERIES)
    counts = [count for each in GROWTHS for count in range(min(each.start or SEARCHED, largest), largest, each.step)]
    nearest, dense = 2.0 * queries * size.source * sum(counts), 4.0 * queries * sum(count**2 for count in counts)
    if piecewise:
        on_device, small = _sample_steps(size, largest)
        nearest, dense = nearest + on_device, dense + small
    if options.readout.refine == "wavelet":
        nearest += WAVELET_STEPS * 4.0 * size.source * size.target * size.functions
    maps = 1 + options.search.alternatives
    return maps * nearest, maps * dense


def _sample_steps(size: Sizes, largest: int) -> tuple[float, float]:
    """Return the operations of all two-way steps on samples, and of the comparisons of pieces."""
    high = [*len(GROWTHS) * SETTLING, *GENERATIONS * (*REGROWTH, *SETTLING)]
    low = [*GENERATIONS * LOW_REGROWTH, *len(GROWTHS) * (largest,)]
    nearest = 0.0
    dense = (len(GROWTHS) + 3 * GENERATIONS) * _map_operations(min(LIMIT, size.descriptors))
    for steps, available in ((high, size.descriptors), (low, size.functions)):
        counts = [min(count, available) for count in steps]
        # Functions are turned at all vertices, then compared with samples of the other shape, both ways.
        nearest += 2.0 * size.both * sum((count + SAMPLES) * count for count in counts)
        dense += sum(_map_operations(count) for count in counts)
    return nearest, dense


def _map_operations(count: int) -> float:
    """Return the operations of a functional map from samples of both sides, and of its factors."""
    return 8.0 * SAMPLES * count**2 + 25.0 * count**3
