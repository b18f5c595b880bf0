"""What landmarks and starts are worth: symmetric shapes settled by one or three landmarks, and time saved by starts.

    python tools/known.py symmetric HUMANS
    python tools/known.py starts HUMANS

HUMANS is a folder of posed humans with one connectivity. Both match with the preset "fast" and print a Markdown
table. A map is right if its mean error is below 0.1 sqrt(area): between the symmetries it is several times that.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

import clalign
from clalign.benchmark.perturb import renumber
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options

RIGHT = 0.1
FAST = Options.preset("fast")
POINTS = 800
Radius = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Case = tuple[str, Mesh, Mesh, NDArray[np.int64], Options]


def directions(seed: int) -> NDArray[np.float64]:
    """Return points (n, 3) spread evenly over the sphere, turned at random: other triangles for each seed."""
    number = np.arange(POINTS) + 0.5
    height, angle = 1 - 2 * number / POINTS, np.pi * (1 + 5**0.5) * number
    ring = np.sqrt(1 - height**2)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    return points @ np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def pair_of(name: str, shape: Radius, seed: int, orientation: str) -> Case:
    """Return a body twice, with different vertices, and the true map."""
    meshes, places = [], []
    for number in (2 * seed, 2 * seed + 1):
        on_sphere = directions(number)
        faces = ConvexHull(on_sphere).simplices
        faces[np.linalg.det(on_sphere[faces]) < 0] = faces[np.linalg.det(on_sphere[faces]) < 0][:, ::-1]
        meshes.append(mesh_from_arrays(shape(on_sphere), faces, f"{name} {number}"))
        places.append(on_sphere)
    truth = cKDTree(places[1]).query(places[0])[1]
    return name, *meshes, truth, FAST.replace({"search.orientation": orientation})


def symmetric_bodies() -> Iterator[Case]:
    """Seventeen bodies: ellipsoids, boxes, stars, and bumps that a mirror repeats."""
    for seed, axes in enumerate([(1, 0.7, 0.45), (1, 0.8, 0.5), (1, 0.6, 0.5), (1, 0.75, 0.3)]):
        yield pair_of("ellipsoid", lambda d, axes=axes: d * axes, seed, "preserving")
    for seed, axes in enumerate([(1, 0.7, 0.45), (1, 0.6, 0.4), (1, 0.8, 0.55), (1, 0.5, 0.3)], start=4):
        yield pair_of("box", lambda d, axes=axes: axes * d / (d**6).sum(axis=1)[:, None] ** (1 / 6), seed, "preserving")
    for seed, fold in enumerate([3, 4, 5, 6, 7], start=8):

        def star(d: NDArray[np.float64], fold: int = fold) -> NDArray[np.float64]:
            around = np.arctan2(d[:, 1], d[:, 0])
            longer = 1 + 0.5 * np.cos(fold * around) * (d[:, 0] ** 2 + d[:, 1] ** 2)
            # Above is not below, so that turns are the only symmetries that keep the orientation.
            return d * longer[:, None] * np.array([1.0, 1.0, 0.4]) + 0.1 * np.outer(longer, [0, 0, 1.0])

        yield pair_of(f"star, {fold}-fold", star, seed, "preserving")
    for seed in range(13, 17):
        rng = np.random.default_rng(seed)
        centres = rng.normal(size=(4, 3))
        centres = (
            np.concatenate([centres, centres * [-1, 1, 1]])
            / np.linalg.norm(centres, axis=1).repeat(2)[[0, 2, 4, 6, 1, 3, 5, 7], None]
        )
        heights = np.tile(rng.uniform(0.3, 0.7, 4), 2)
        yield pair_of(
            "bumps and mirror image",
            lambda d, c=centres, h=heights: d * [1, 0.8, 0.65] * (1 + np.exp(6 * (d @ c.T - 1)) @ h)[:, None],
            seed,
            "any",
        )


def human_pair(folder: Path, one: str, other: str, seed: int, options: Options) -> Case:
    """Return two humans, the second with shuffled vertices."""
    source, target = (clalign.load_mesh(next(folder.glob(f"{name}.*"))) for name in (one, other))
    shuffled = renumber(target, seed)
    return f"human {one} {other}", source, shuffled.mesh, shuffled.truth.target_points, options


def mean_error(result: Any, truth: NDArray[np.int64]) -> float:
    """Return the mean straight distance of matches from the truth, in sqrt(area)."""
    target = result.target
    return float(np.linalg.norm(target.vertices[result.target_of_source] - target.vertices[truth], axis=1).mean())


def say(line: str) -> None:
    """Write a line of the table."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def symmetric(folder: Path) -> None:
    """Match every symmetric case with no, one and three landmarks."""
    either = FAST.replace({"search.orientation": "any"})
    names = [("ap0", "ap2"), ("bp0", "bp4"), ("cp2", "cp0")]
    cases = [*symmetric_bodies(), *(human_pair(folder, *pair, 3, either) for pair in names)]
    say("| shape | without: right | as good, said | one landmark | three landmarks |\n|---|---|---:|---|---|")
    right = np.zeros(3, dtype=int)
    for name, source, target, truth, options in cases:
        # Far from the middle of the body, so that the symmetries send them elsewhere; none on an axis of symmetry.
        off = np.abs(source.vertices).min(axis=1) * np.linalg.norm(source.vertices, axis=1)
        spread = np.argsort(-off)[: source.n_vertices // 4]
        chosen = np.random.default_rng(1).choice(spread, 3, replace=False)
        said, marks = 0, []
        for number, count in enumerate((0, 1, 3)):
            known = np.stack([chosen[:count], truth[chosen[:count]]], axis=1) if count else None
            result = clalign.match(source, target, options, landmarks=known)
            good = mean_error(result, truth) < RIGHT
            right[number] += good
            marks.append("yes" if good else f"no ({mean_error(result, truth):.2f})")
            said = len(result.equally_good) if not count else said
        say(f"| {name} | {marks[0]} | {said} | {marks[1]} | {marks[2]} |")
    say(f"| **right** | {right[0]} of {len(cases)} | | {right[1]} of {len(cases)} | {right[2]} of {len(cases)} |")


def pyfm_start(source: Mesh, target: Mesh, truth: NDArray[np.int64], size: int = 20) -> tuple[Any, Any, Any]:
    """Return (C, Φ, Ψ) that pyFM fits to wave kernel signatures and five landmarks."""
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh

    one, other = (
        TriMesh(mesh.file_positions(), mesh.file_faces, center=True, area_normalize=True) for mesh in (source, target)
    )
    known = np.random.default_rng(0).choice(source.n_vertices, 5, replace=False)
    model = FunctionalMapping(one, other)
    marks = np.stack([known, truth[known]], axis=1)
    model.preprocess(n_descr=100, descr_type="WKS", landmarks=marks, subsample_step=5, k_process=60)
    model.fit(K=(size, size), w_descr=1.0, w_lap=1e-2, w_dcomm=1e-1, w_orient=0)
    return model.FM, model.mesh1.eigenvectors[:, :size], model.mesh2.eigenvectors[:, :size]


def starts(folder: Path, limit: int | None) -> None:
    """Match twenty pairs, or the first ones of them, by search and from three kinds of starts."""
    options = FAST
    same = [(f"{who}p{a}", f"{who}p{b}") for who in "abcde" for a, b in ((0, 2), (1, 4))]
    across = [(f"{one}p{pose}", f"{other}p{pose}") for pose in (0, 1) for one, other in ("ab", "bc", "cd", "de", "ea")]
    kinds = ("search", "30 % wrong", "pyFM 20 × 20", "rigid")
    right, seconds, errors = (dict.fromkeys(kinds, 0.0) for _ in range(3))
    rigid_pairs = 0
    pairs = [names for both in zip(same, across, strict=True) for names in both][:limit]
    for number, names in enumerate(pairs):
        _, source, target, truth, _ = human_pair(folder, *names, number, options)
        rng = np.random.default_rng(number)
        wrong = rng.random(len(truth)) < 0.3
        rough = np.where(wrong, rng.integers(0, len(truth), len(truth)), truth)
        given = {"search": None, "30 % wrong": rough, "pyFM 20 × 20": pyfm_start(source, target, truth)}
        if names in across:
            given["rigid"] = "rigid"
            rigid_pairs += 1
        for kind, start in given.items():
            began = time.process_time()
            result = clalign.match(source, target, options, start=start)
            seconds[kind] += time.process_time() - began
            off = mean_error(result, truth)
            right[kind] += off < RIGHT
            errors[kind] += off
            say(f"    {' '.join(names)} {kind}: {100 * off:.2f}")
    say("| start | right | mean error x 100 | seconds of processor time a pair |\n|---|---:|---:|---:|")
    for kind in kinds:
        count = rigid_pairs if kind == "rigid" else len(pairs)
        found, off, spent = right[kind], 100 * errors[kind] / count, seconds[kind] / count
        say(f"| {kind} | {found:.0f} of {count} | {off:.2f} | {spent:.1f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("symmetric", "starts"))
    parser.add_argument("humans", type=Path)
    parser.add_argument("--limit", type=int, help="the first so many pairs of the starts")
    words = parser.parse_args()
    warnings.simplefilter("ignore")
    if words.part == "symmetric":
        symmetric(words.humans)
    else:
        starts(words.humans, words.limit)
