"""A desktop window with both shapes, through pyvista (the extra "view")."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.mesh.front import Up
from clalign.presentation.picture import pair_colours, pair_views


def show(
    correspondence: Correspondence,
    *,
    up: Up | None = None,
    screenshot: str | Path | None = None,
) -> None:
    """Open a window with source and target side by side, turning together; blocks until it is closed.

    Parameters
    ----------
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
    meshes, views = (correspondence.source, correspondence.target), pair_views(correspondence, up)
    plotter: Any = pyvista.Plotter(shape=(1, 2), off_screen=screenshot is not None, window_size=[1400, 800])
    for column, (mesh, view, colours) in enumerate(
        zip(meshes, views, pair_colours(correspondence, views[1]), strict=True)
    ):
        plotter.subplot(0, column)
        plotter.set_background("white")
        surface = pyvista.PolyData.from_regular_faces(mesh.vertices @ view.T, mesh.faces)
        plotter.add_mesh(surface, scalars=colours, rgb=True, smooth_shading=True)
        plotter.add_text(mesh.name, font_size=10, color="black")
    plotter.link_views()
    plotter.view_xy()
    if screenshot is None:
        plotter.show()
    else:
        plotter.screenshot(str(screenshot))
    plotter.close()
