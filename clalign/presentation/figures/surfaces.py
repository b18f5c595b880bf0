"""Panels of the two shapes of a match, seen alike and at one scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.presentation.camera import Up, front_view
from clalign.presentation.figures.sheet import Image
from clalign.presentation.picture import map_rotation
from clalign.presentation.raster import rasterise
from clalign.transfer.colours import carried_colours, function_colours, position_colours
from clalign.transfer.surface_map import SurfaceMap, surface_map

_MARGIN = 0.04
_FULL_COLOUR = 0.98

Colour = tuple[float, float, float]


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
    def of(correspondence: Correspondence, up: Up | None = None) -> PairView:
        """Return the view in which the source faces like the target."""
        source, target = correspondence.source, correspondence.target
        view = front_view(target.vertices, up)
        turn = map_rotation(source.vertices, target.vertices, surface_map(correspondence))
        return PairView(
            source=_centred(source.vertices @ (view @ turn).T),
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
        background: Colour = (1.0, 1.0, 1.0),
    ) -> tuple[Image, Image]:
        """Return images of both shapes, of one size, with (n, 3) colours."""
        both = np.concatenate([self.source, self.target])
        extent = 2.0 * np.abs(both[:, :2]).max(axis=0)
        scale = height * (1.0 - 2.0 * _MARGIN) / max(float(extent[1]), 0.4 * float(extent[0]))
        width = int(np.ceil(extent[0] * scale + 2.0 * _MARGIN * height))
        first, second = (
            rasterise(
                vertices * scale + (width / 2, height / 2, 0.0), faces, colours, (width, height), background=background
            )
            for vertices, faces, colours in (
                (self.source, self.source_faces, source_colours),
                (self.target, self.target_faces, target_colours),
            )
        )
        return first, second

    def function_panels(
        self,
        source_values: NDArray[np.float64],
        target_values: NDArray[np.float64],
        height: int,
        background: Colour = (1.0, 1.0, 1.0),
    ) -> tuple[Image, Image]:
        """Return images of a signed function on each shape (n,), in one colour scale: red above zero, blue below."""
        limit = float(np.quantile(np.abs(np.concatenate([source_values, target_values])), _FULL_COLOUR))
        return self.panels(
            function_colours(source_values, limit=limit),
            function_colours(target_values, limit=limit),
            height,
            background,
        )

    def map_panels(
        self, target_vertices: NDArray[np.float64], to_target: SurfaceMap, height: int
    ) -> tuple[Image, Image]:
        """Return images with the colours of places on the target, carried to the source by a map."""
        colours = position_colours(target_vertices, self.view)
        return self.panels(carried_colours(colours, to_target), colours, height)


def _centred(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    return vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
