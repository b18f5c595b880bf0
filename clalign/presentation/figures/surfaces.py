"""Panels of the two shapes of a match, seen alike and at one scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.presentation.figures.sheet import PLAIN, Image
from clalign.presentation.picture import pair_colours, pair_views
from clalign.presentation.raster import rasterise
from clalign.transfer.colours import function_colours

_MARGIN = 0.04
_FULL_COLOUR = 0.98

Colour = tuple[float, float, float]
Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class PairView:
    """Both shapes of a match in viewing coordinates (right, up, towards the viewer).

    Attributes
    ----------
    source, target : (n, 3) vertices.
    source_faces, target_faces : (m, 3).
    view : (3, 3) rotation of the target to viewing axes.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]
    source_faces: NDArray[np.int32]
    target_faces: NDArray[np.int32]
    view: NDArray[np.float64]

    @staticmethod
    def of(correspondence: Correspondence) -> PairView:
        """Return the view in which the source faces like the target."""
        source, target = correspondence.source, correspondence.target
        turned, view = pair_views(correspondence)
        return PairView(
            source=_centred(source.vertices @ turned.T),
            target=_centred(target.vertices @ view.T),
            source_faces=source.faces,
            target_faces=target.faces,
            view=view,
        )

    def panels(
        self,
        source_colours: NDArray[np.float64],
        target_colours: NDArray[np.float64],
        height: int,
        ground: Colour = PLAIN,
    ) -> tuple[Image, Image]:
        """Return images of both shapes, of one size, with (n, 3) colours on a background."""
        both = np.concatenate([self.source, self.target])
        extent = 2.0 * np.abs(both[:, :2]).max(axis=0)
        scale = height * (1.0 - 2.0 * _MARGIN) / max(float(extent[1]), 0.4 * float(extent[0]))
        width = int(np.ceil(extent[0] * scale + 2.0 * _MARGIN * height))
        middle = (width / 2, height / 2, 0.0)
        source, target = self.source * scale + middle, self.target * scale + middle
        return (
            rasterise(source, self.source_faces, source_colours, (width, height), background=ground),
            rasterise(target, self.target_faces, target_colours, (width, height), background=ground),
        )

    def function_panels(self, functions: Pair, index: int, height: int, ground: Colour = PLAIN) -> tuple[Image, Image]:
        """Return images of one of some functions on source and target, in one colour scale: red above zero, blue below.

        Parameters
        ----------
        functions : (n_x, d) and (n_y, d).
        index : column of both.
        """
        values = [each[:, index] for each in functions]
        limit = float(np.quantile(np.abs(np.concatenate(values)), _FULL_COLOUR))
        source, target = (function_colours(each, limit=limit) for each in values)
        return self.panels(source, target, height, ground)

    def map_panels(self, correspondence: Correspondence, height: int) -> tuple[Image, Image]:
        """Return images with the colours of places on the target, carried to the source by a match of this pair."""
        return self.panels(*pair_colours(correspondence, self.view), height)


def _centred(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    return vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
