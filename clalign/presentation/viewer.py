"""A desktop window with both shapes, through pyvista (the extra "view")."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.mesh.mesh import Mesh
from clalign.presentation.camera import Up, front_view
from clalign.presentation.picture import map_rotation
from clalign.transfer.colours import carried_colours, position_colours
from clalign.transfer.surface_map import surface_map


def show(
    correspondence: Correspondence,
    *,
    up: Up | None = None,
    screenshot: str | Path | None = None,
) -> None:
    """Open a window with source and target side by side, turning together; blocks until it is closed.

    Parameters
    ----------
    correspondence : the match.
    up : coordinate axis of the target that points up, if the guess from its extent is wrong.
    screenshot : write a PNG there instead of opening a window.

    Raises
    ------
    InputError
        pyvista is not installed.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError("the viewer needs pyvista; install it with: pip install 'clalign[view]'") from error
    source, target = correspondence.source, correspondence.target
    view = front_view(target.vertices, up)
    to_target = surface_map(correspondence)
    on_target = position_colours(target.vertices, view)
    on_source = carried_colours(on_target, to_target)
    source_view = view @ map_rotation(source.vertices, target.vertices, to_target)
    plotter: Any = pyvista.Plotter(shape=(1, 2), off_screen=screenshot is not None, window_size=[1400, 800])
    for column, (mesh, axes, values) in enumerate(((source, source_view, on_source), (target, view, on_target))):
        plotter.subplot(0, column)
        plotter.set_background("white")
        plotter.add_mesh(_surface(pyvista, mesh, axes), scalars=values, rgb=True, smooth_shading=True)
        plotter.add_text(mesh.name, font_size=10, color="black")
    plotter.link_views()
    plotter.view_xy()
    if screenshot is None:
        plotter.show()
    else:
        plotter.screenshot(str(screenshot))
    plotter.close()


def _surface(pyvista: Any, mesh: Mesh, axes: NDArray[np.float64]) -> Any:
    faces = np.concatenate([np.full((mesh.n_faces, 1), 3), mesh.faces], axis=1)
    return pyvista.PolyData(mesh.vertices @ axes.T, faces.ravel())
