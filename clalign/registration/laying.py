"""Lay the source's connectivity on the target's surface: from matches to a mesh without folds.

    precise matches → as-similar-as-possible solves that come ever closer to the surface → folds taken out in charts →
    solves once more, as far as they fold nothing

Vertices without a match, and inner ones that a map crowds at the edge of a hole, keep to the shape of the source.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import boundary_vertices, edge_table, graph_components, vertex_areas, vertex_normals
from clalign.refinement.precise import SurfacePoints
from clalign.registration.measures import relative_areas
from clalign.registration.places import Projection, Rim, nearest_corner, some, walked, with_some
from clalign.registration.rigidity import Solver, Springs
from clalign.registration.untangling import turned_over, untangled
from clalign.rules import RegistrationRules

HELD = 1e6
"""Pull that keeps a vertex where it is, against springs of about one."""
LEAST_PULL = 1e-9
"""Of a vertex that nothing else pulls, so that a piece without any match has a place."""
SAME_SIZE = 1.25
"""Up to this factor, or its inverse, both meshes count as of one size."""
HALVED, TAKEN_BACK = 4, 12
"""Times that moves around new folds are halved, and times after which, taken back one by one, all are."""


@dataclass(frozen=True)
class Laid:
    """A source laid on a target, in the unit and place of the target's mesh.

    Attributes
    ----------
    positions : (n, 3) float64.
    places : (n,) on the target; without meaning where not `lying`.
    lying : (n,) bool, vertices that lie on the target; the others fill what is missing there.
    """

    positions: NDArray[np.float64]
    places: SurfacePoints
    lying: NDArray[np.bool_]


def laid(
    source: Mesh, target: Mesh, matches: SurfacePoints, matched: NDArray[np.bool_], rules: RegistrationRules
) -> Laid:
    """Return the source laid on the target.

    Parameters
    ----------
    matches : (n,) points of the target for the vertices of the source.
    matched : (n,) bool, which of them are known; at least one.
    """
    fit = _Fit(source, target, matches, matched, rules)
    positions, places = fit.filled(fit.wanted), matches
    for surface in rules.surface:
        positions, places = fit.drawn(positions, places, surface, rules.solves)
    places = untangled(source.vertices, source.faces, target, places, fit.lying)
    return fit.settled(positions, places)


class _Fit:
    """What does not change between the steps of a registration, and how far the matches have shown to be right."""

    def __init__(
        self, source: Mesh, target: Mesh, matches: SurfacePoints, matched: NDArray[np.bool_], rules: RegistrationRules
    ) -> None:
        self.source, self.target, self.rules = source, target, rules
        self.project = Projection(target)
        self.mass = vertex_areas(source.vertices, source.faces) * source.n_vertices
        self.wanted = self.project.positions(matches)
        self.trust = np.ones(source.n_vertices)
        rim = boundary_vertices(source.faces, source.n_vertices)
        self.rim = Rim(target) if rim.any() and self.project.rim.any() else None
        self.on_rim = rim & matched
        if self.rim is not None:
            off = self.project.distance(self.wanted, self.rim.nearest(self.wanted))
            self.on_rim &= off < rules.rim * equilateral_edge(target)
        # An inner vertex whose match lies at the edge of the target belongs to something that is missing there.
        self.lying = matched & (rim | ~self.project.at_rim(matches))
        if not self.lying.any():
            self.lying = matched
        scale = self.size_of_source()
        self.springs = Springs.of(scale * source.vertices, source.faces)
        self.edge = scale * equilateral_edge(source)

    def size_of_source(self) -> float:
        """Return the length in the target's unit of one in the source's: about 1 unless one is a part of the other."""
        table = edge_table(self.source.faces, self.source.n_vertices)
        one, other = table.edges[self.lying[table.edges].all(axis=1)].T
        rest, now = (
            np.linalg.norm(points[one] - points[other], axis=1) for points in (self.source.vertices, self.wanted)
        )
        ratio = float(np.median(now / rest)) if len(one) else 1.0
        # Rough matches lengthen edges a little, which is no size.
        return 1.0 if 1.0 / SAME_SIZE < ratio < SAME_SIZE or ratio == 0.0 else ratio

    def filled(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions with each part that does not lie on the target moved along with what is around it."""
        found, rest, faces = positions.copy(), self.source.vertices, self.source.faces
        filling = np.flatnonzero(~self.lying)
        tail, head = self.springs.tail, self.springs.head
        inside = ~self.lying[tail] & ~self.lying[head]
        _, label = graph_components(len(rest), tail[inside], head[inside])
        for part in np.unique(label[filling]):
            mine = (label == part) & ~self.lying
            near = mine
            while (near & self.lying).sum() < min(self.rules.carried_by, self.lying.sum()):
                touched = near[faces].any(axis=1)
                wider = near.copy()
                wider[faces[touched]] = True
                if (wider == near).all():
                    wider = np.ones_like(near)
                near = wider
            known = near & self.lying
            rotation, scale, before, after = similarity(rest[known], positions[known])
            found[mine] = scale * (rest[mine] - before) @ rotation + after
        return found

    def drawn(
        self, positions: NDArray[np.float64], places: SurfacePoints, surface: float, solves: int
    ) -> tuple[NDArray[np.float64], SurfacePoints]:
        """Return positions and places after solves that draw the source to its matches and to the surface.

        A pull of m / ℓ², with m the area of a vertex in mean ones, gives way to the springs over ℓ edges.
        """
        on = np.where(self.lying, self.mass, 0.0)
        to_match, to_surface = on * self.trust / self.rules.match**2, on / surface**2
        pull = to_match + to_surface + LEAST_PULL
        solver = Solver(self.springs, pull)
        for number in range(solves):
            on_surface = self.project.positions(places)
            wanted = to_match[:, None] * self.wanted + to_surface[:, None] * on_surface + LEAST_PULL * positions
            positions = solver(positions, wanted / pull[:, None], ~self.lying)
            if number % 2 or number + 1 == solves:
                places = self.projected(positions, places)
        off = np.linalg.norm(positions - self.wanted, axis=1) / (self.rules.match * self.edge)
        self.trust = 1.0 / (1.0 + off**2)
        return positions, places

    def projected(self, positions: NDArray[np.float64], places: SurfacePoints) -> SurfacePoints:
        """Return the places nearest to positions; those of the source's rim on the target's, where matches were."""
        found = self.project(positions, vertex_normals(positions, self.source.faces), places)
        if self.rim is not None and self.on_rim.any():
            found = with_some(found, self.on_rim, self.rim.nearest(positions[self.on_rim]))
        return found

    def settled(self, positions: NDArray[np.float64], places: SurfacePoints) -> Laid:
        """Return the source on the target after more solves, each taken back where it folds or collapses a face."""
        positions = self.on_target(positions, places)
        for _ in range(self.rules.settling):
            _, moved = self.drawn(positions, places, self.rules.surface[-1], 1)
            places = self.without_new_folds(places, moved)
            positions = self.on_target(positions, places)
        return Laid(positions, places, self.lying)

    def on_target(self, positions: NDArray[np.float64], places: SurfacePoints) -> NDArray[np.float64]:
        """Return positions with vertices at their places, and those without one where the springs leave them."""
        on = self.project.positions(places)
        if self.lying.all():
            return on
        found = np.where(self.lying[:, None], on, positions)
        solver = Solver(self.springs, np.where(self.lying, HELD, LEAST_PULL))
        for _ in range(self.rules.filling):
            found = solver(found, found, ~self.lying)
        return np.where(self.lying[:, None], on, found)

    def without_new_folds(self, before: SurfacePoints, after: SurfacePoints) -> SurfacePoints:
        """Return new places but for the corners of faces that they would spoil, which go a part of the way or none."""
        allowed, share = self.spoilt(before), np.ones(self.source.n_vertices)
        start, end = self.project.positions(before), self.project.positions(after)
        for number in range(TAKEN_BACK):
            worse = self.spoilt(after) & ~allowed
            if not worse.any():
                return after
            kept = np.unique(self.source.faces[worse.any(axis=1)])
            share[kept] = share[kept] / 2 if number < HALVED else 0.0
            between = start[kept] + share[kept, None] * (end[kept] - start[kept])
            near = walked(between, self.target, nearest_corner(self.target.faces, some(before, kept)))
            if self.rim is not None and (edge := self.on_rim[kept]).any():
                near = with_some(near, edge, self.rim.nearest(between[edge]))
            back = some(before, kept)
            after = with_some(after, kept, with_some(near, share[kept] == 0.0, some(back, share[kept] == 0.0)))
        return before

    def spoilt(self, places: SurfacePoints) -> NDArray[np.bool_]:
        """Return (m, 2) which faces on the target are turned over, and which have all but collapsed."""
        faces = self.source.faces
        area = relative_areas(self.project.positions(places), self.source.vertices, faces)
        small = (area < self.rules.least_area) & self.lying[faces].all(axis=1)
        return np.stack([turned_over(faces, self.target, places, self.lying), small], axis=1)


def similarity(
    before: NDArray[np.float64], after: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3), scale and both middles (3,) of the similarity that fits points (k, 3) best.

    Umeyama 1991: ``scale * (x - first middle) @ rotation + second middle`` is where a point x goes.
    """
    middle, other = before.mean(axis=0), after.mean(axis=0)
    left, values, right = np.linalg.svd((before - middle).T @ (after - other))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    spread = float(((before - middle) ** 2).sum())
    scale = float((values * sign).sum()) / spread if spread > 0 else 1.0
    return (left * sign) @ right, scale if scale > 0 else 1.0, middle, other


def equilateral_edge(mesh: Mesh) -> float:
    """Return the side of as many equilateral triangles as a mesh has, with its area of 1 in all."""
    return 2.0 / math.sqrt(math.sqrt(3.0) * mesh.n_faces)
