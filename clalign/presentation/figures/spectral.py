"""Fig. 3 and 9: the true C̃ with its funnel, and the alignment error of every eigenfunction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.band import band_mask, funnel_band
from clalign.correspondence import Correspondence
from clalign.evaluation import spectral
from clalign.maps.functional_maps import PointMaps
from clalign.presentation.curves import new_figure
from clalign.presentation.figures.sheet import Drawing
from clalign.storage.files import visible

_RUNNING = 11
_GAMMA = 0.5


def draw_funnel(result: Correspondence, maps: PointMaps) -> Drawing:
    """Draw Fig. 3: |C̃| of the truth, the mask of the options beside it (outlined in both), and the recovered |C̃|."""
    from matplotlib.colors import PowerNorm

    count = min(result.rotation.shape)
    true = spectral.rotation_of_truth(result, maps)
    recovered = spectral.recovered_rotation(result)
    band = funnel_band(count, result.options.alignment)
    mask = band_mask(band)
    figure = new_figure(9.6, 3.5, "constrained")
    panels = figure.subplots(1, 3)
    titles = (
        f"|C̃| of the truth, {spectral.energy_inside(true, mask):.1%} inside",
        f"mask of R: {mask.mean():.1%} of the entries",
        f"|C̃| recovered, {spectral.energy_inside(recovered, mask):.1%} inside",
    )
    extent = (0.5, count + 0.5, count + 0.5, 0.5)
    index = np.arange(1, count + 1)
    for axes, title, values in zip(panels, titles, (np.abs(true), 0.25 * mask, np.abs(recovered)), strict=True):
        axes.imshow(values, cmap="magma_r", norm=PowerNorm(_GAMMA, 0.0, 1.0), extent=extent, interpolation="none")
        # The mask's columns of row i are lower + 1 … upper, counted from 1.
        axes.plot(band.lower + 0.5, index, band.upper + 0.5, index, color="#2a7fb8", linewidth=0.8)
        axes.set_title(visible(title), fontsize=8)
        axes.set(xlim=extent[:2], ylim=extent[2:])
        axes.set_xlabel("eigenfunction of the target", fontsize=8)
        axes.tick_params(labelsize=7)
    panels[0].set_ylabel("eigenfunction of the source", fontsize=8)
    rows_inside = [np.square(np.where(mask, m, 0.0)).sum(1) / np.square(m).sum(1) for m in (true, recovered)]
    norms = [np.linalg.norm(m, axis=1) for m in (true, recovered)]
    columns = (spectral.coupling_spread(true), spectral.coupling_spread(recovered), *rows_inside, *norms)
    rows = tuple(
        (int(i), int(band.lower[i - 1]) + 1, int(band.upper[i - 1]), *(float(column[i - 1]) for column in columns))
        for i in index
    )
    names = ("eigenfunction", "first_column", "last_column", "spread_true", "spread_recovered")
    return Drawing(figure, (*names, "inside_true", "inside_recovered", "norm_true", "norm_recovered"), rows)


def draw_spectral_errors(errors: Mapping[str, spectral.SpectralErrors]) -> Drawing:
    """Draw Fig. 9: err(k) of the unaligned eigenfunctions and after alignment by variants of the method.

    Thin lines are err(k), thick ones their running mean over 11 indices.

    Parameters
    ----------
    errors : label to the errors of one match; the unaligned ones are those of the first.
    """
    first = next(iter(errors.values()))
    curves: dict[str, NDArray[np.float64]] = {"unaligned": first.unaligned, "unaligned, true signs": first.signed}
    curves |= {label: measured.aligned for label, measured in errors.items()}
    figure = new_figure(6.6, 4.3, "constrained")
    axes = figure.add_subplot()
    count = max(len(curve) for curve in curves.values())
    for number, (label, curve) in enumerate(curves.items()):
        index = np.arange(1, len(curve) + 1)
        colour = ("#8a8a8a", "#c0a16b")[number] if number < 2 else f"C{number - 2}"
        axes.plot(index, curve, color=colour, linewidth=0.5, alpha=0.4)
        axes.plot(index, running_mean(curve, _RUNNING), color=colour, linewidth=1.6, label=label)
    axes.set(xlim=(1, count), ylim=(0, 2.05), xlabel="eigenfunction k", ylabel="relative error err(k)")
    axes.grid(alpha=0.3)
    # Beside the axes: thin lines are everywhere inside.
    axes.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    rows = tuple(
        (k + 1, *(float(curve[k]) if k < len(curve) else None for curve in curves.values())) for k in range(count)
    )
    return Drawing(figure, ("eigenfunction", *curves), rows)


def running_mean(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return the mean over a window of `width` (odd) around each entry, cut off at both ends."""
    window = np.ones(width)
    total = np.convolve(values, window)[width // 2 :][: len(values)]
    return np.asarray(total / np.convolve(np.ones(len(values)), window)[width // 2 :][: len(values)])
