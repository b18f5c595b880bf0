"""Colours by position and by value, and their way through a match."""

from __future__ import annotations

import dataclasses

import numpy as np
import shapes

from clalign.correspondence import Correspondence
from clalign.transfer.colours import (
    UNMATCHED,
    amount_colours,
    carried_colours,
    function_colours,
    position_colours,
)
from clalign.transfer.surface_map import surface_map


def test_colours_by_position_are_smooth_and_tell_sides_apart() -> None:
    vertices, _ = shapes.icosphere(4)
    colours = position_colours(vertices, np.eye(3))
    assert colours.min() >= 0
    assert colours.max() <= 1
    mirrored = position_colours(vertices * (-1, 1, 1), np.eye(3))
    assert np.linalg.norm(colours - mirrored, axis=1)[np.abs(vertices[:, 0]) > 0.5].min() > 0.2
    nearby = position_colours(np.concatenate([vertices * 0.999, vertices]), np.eye(3))
    assert np.linalg.norm(np.diff(nearby.reshape(2, -1, 3), axis=0), axis=2).max() < 0.02


def test_function_colours_are_red_above_and_blue_below() -> None:
    colours = function_colours(np.array([-1.0, 0.0, 1.0]), limit=1.0)
    assert colours[0, 2] > colours[0, 0]
    assert np.ptp(colours[1]) < 0.03
    assert colours[2, 0] > colours[2, 2]
    assert amount_colours(np.array([0.0, 5.0]), 0.0, 5.0).sum(axis=1).tolist() == sorted(
        amount_colours(np.array([0.0, 5.0]), 0.0, 5.0).sum(axis=1)
    )


def test_source_takes_the_colours_of_its_matches(small: Correspondence) -> None:
    colours = np.random.default_rng(1).uniform(size=(small.target.n_vertices, 3))
    carried = carried_colours(colours, surface_map(small))
    # Vertex i of the surface is vertex i + 1 of the file here.
    for vertex in (0, 17, 641):
        assert np.array_equal(carried[vertex], colours[small.target_of_source[vertex + 1] - 1])


def test_unmatched_vertices_are_grey(small: Correspondence) -> None:
    lost = small.target_of_source.copy()
    lost[5] = -1
    partial = dataclasses.replace(small, target_of_source=lost)
    carried = carried_colours(np.ones((small.target.n_vertices, 3)), surface_map(partial))
    assert np.array_equal(np.flatnonzero((carried == UNMATCHED).all(axis=1)), [4])
