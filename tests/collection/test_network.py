"""Synchronisation and cycles on networks made from known rotations, some of their maps wrong."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from clalign.collection.network import (
    MapEdges,
    components,
    cycle_errors,
    cycle_weights,
    deviation,
    spanning_tree,
    synchronise,
)
from clalign.maps.functional_maps import polar_factor
from clalign.rules import CollectionRules

RULES = CollectionRules()
TRUSTING = CollectionRules(reweightings=0)

SHAPES, SIZE = 12, 8


def orthogonal(rng: np.random.Generator, count: int, size: int = SIZE) -> NDArray[np.float64]:
    return polar_factor(rng.normal(size=(count, size, size)))


def all_pairs(count: int) -> NDArray[np.int64]:
    return np.array([(i, j) for i in range(count) for j in range(i + 1, count)])


def network(frames: NDArray[np.float64], pairs: NDArray[np.int64]) -> MapEdges:
    maps = frames[pairs[:, 1]] @ frames[pairs[:, 0]].transpose(0, 2, 1)
    return MapEdges(len(frames), pairs, maps, np.ones(len(pairs)))


def changed(edges: MapEdges, maps: NDArray[np.float64]) -> MapEdges:
    return MapEdges(edges.count, edges.pairs, maps, edges.weights)


def worst(edges: MapEdges, frames: NDArray[np.float64]) -> float:
    """Largest deviation over all pairs of shapes of the network's maps from those of the true frames."""
    found = synchronise(edges, RULES)
    everything = all_pairs(len(frames))
    got = np.stack([found.functional(i, j) for i, j in everything.tolist()])
    return float(deviation(got - network(frames, everything).maps).max())


@pytest.mark.parametrize("kind", ["all", "star", "chain", "ring"])
def test_consistent_maps_are_found_again_whatever_the_pairs(kind: str, rng: np.random.Generator) -> None:
    pairs = {
        "all": all_pairs(SHAPES),
        "star": np.array([(i, 5) if i < 5 else (5, i) for i in range(SHAPES) if i != 5]),
        "chain": np.array([(i, i + 1) for i in range(SHAPES - 1)]),
        "ring": np.array([(i, (i + 1) % SHAPES) for i in range(SHAPES)]),
    }[kind]
    frames = orthogonal(rng, SHAPES)
    assert worst(network(frames, pairs), frames) < 1e-7


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4])
def test_wrong_maps_are_outvoted_and_found(share: float, rng: np.random.Generator) -> None:
    frames = orthogonal(rng, SHAPES)
    true = network(frames, all_pairs(SHAPES))
    wrong = rng.permutation(len(true.pairs))[: round(share * len(true.pairs))]
    maps = true.maps.copy()
    maps[wrong] = orthogonal(rng, wrong.size)
    edges = changed(true, maps)
    assert worst(edges, frames) < 0.02
    found = synchronise(edges, RULES)
    assert set(np.flatnonzero(found.residuals > 0.5)) == set(wrong.tolist())


def test_flips_of_a_symmetric_body_are_found_though_they_agree_with_each_other(rng: np.random.Generator) -> None:
    """Every flip is the same reflection of the latent basis, so that two flips and a right map close a cycle."""
    frames = orthogonal(rng, SHAPES)
    flip = np.diag(np.where(np.arange(SIZE) % 2, -1.0, 1.0))
    true = network(frames, all_pairs(SHAPES))
    wrong = rng.permutation(len(true.pairs))[:16]
    maps = true.maps.copy()
    for edge in wrong:
        i, j = true.pairs[edge]
        maps[edge] = frames[j] @ flip @ frames[i].T
    noisy = polar_factor(maps + 0.05 * rng.normal(size=maps.shape))
    edges = changed(true, noisy)
    found = synchronise(
        MapEdges(SHAPES, edges.pairs, noisy, cycle_weights(np.ones(len(noisy)), cycle_errors(edges), RULES)), RULES
    )
    assert set(np.flatnonzero(found.residuals > 0.5)) == set(wrong.tolist())


def test_averaging_over_cycles_lessens_noise(rng: np.random.Generator) -> None:
    frames = orthogonal(rng, SHAPES)
    true = network(frames, all_pairs(SHAPES))
    noisy = polar_factor(true.maps + 0.1 * rng.normal(size=true.maps.shape))
    found = synchronise(changed(true, noisy), RULES)
    got = np.stack([found.functional(i, j) for i, j in true.pairs.tolist()])
    assert deviation(got - true.maps).mean() < 0.6 * deviation(noisy - true.maps).mean()


def test_network_maps_close_every_cycle_exactly(rng: np.random.Generator) -> None:
    maps = orthogonal(rng, len(all_pairs(5)))
    found = synchronise(MapEdges(5, all_pairs(5), maps, np.ones(len(maps))), RULES)
    around = found.functional(1, 4) @ found.functional(3, 1) @ found.functional(4, 3)
    np.testing.assert_allclose(around, np.eye(SIZE), atol=1e-12)


def test_subspace_iteration_finds_the_leading_eigenvectors(rng: np.random.Generator) -> None:
    """Against numpy's eigenvectors of the dense block matrix, on maps that no frames explain exactly."""
    pairs = all_pairs(6)
    frames = orthogonal(rng, 6, 4)
    maps = polar_factor(network(frames, pairs).maps + 0.2 * rng.normal(size=(len(pairs), 4, 4)))
    weights = rng.uniform(0.2, 1.0, len(pairs))
    degree = np.zeros(6)
    block = np.zeros((6, 4, 6, 4))
    for (i, j), functional, weight in zip(pairs.tolist(), maps, weights, strict=True):
        degree[[i, j]] += weight
        block[j, :, i], block[i, :, j] = weight * functional, weight * functional.T
    block /= np.sqrt(degree)[:, None, None, None] * np.sqrt(degree)[None, None, :, None]
    leading = np.linalg.eigh(block.reshape(24, 24))[1][:, -4:].reshape(6, 4, 4)
    expected = polar_factor(leading)
    found = synchronise(MapEdges(6, pairs, maps, weights), TRUSTING)
    for i, j in pairs.tolist():
        np.testing.assert_allclose(found.functional(i, j), expected[j] @ expected[i].T, atol=1e-7)


def test_cycle_errors_point_at_the_wrong_map(rng: np.random.Generator) -> None:
    frames = orthogonal(rng, 6)
    edges = network(frames, all_pairs(6))
    maps = edges.maps.copy()
    maps[4] = orthogonal(rng, 1)[0]
    errors = cycle_errors(changed(edges, maps))
    assert errors[4] > 0.7
    assert np.delete(errors, 4).max() < 1e-12
    assert np.isnan(cycle_errors(network(frames, np.array([(0, 1), (0, 2), (0, 3)])))).all()
    sampled = cycle_errors(changed(edges, maps), most=2, seed=3)
    np.testing.assert_array_equal(sampled, cycle_errors(changed(edges, maps), most=2, seed=3))


def test_shapes_that_no_pair_joins_have_no_map(rng: np.random.Generator) -> None:
    frames = orthogonal(rng, 5)
    found = synchronise(network(frames, np.array([(0, 1), (3, 4)])), RULES)
    assert found.component.tolist() == [0, 0, 1, 2, 2]
    np.testing.assert_allclose(found.functional(3, 4), frames[4] @ frames[3].T, atol=1e-9)
    with pytest.raises(ValueError, match="no chain of pairs joins the shapes 0 and 3"):
        found.functional(0, 3)


def test_groups_do_not_disturb_each_other(rng: np.random.Generator) -> None:
    """The maps of a noisy group are the same whether or not there is a perfect group beside it."""
    pairs = all_pairs(4)
    noisy = polar_factor(network(orthogonal(rng, 4), pairs).maps + 0.3 * rng.normal(size=(6, SIZE, SIZE)))
    alone = synchronise(MapEdges(4, pairs, noisy, np.ones(6)), RULES)
    perfect = network(orthogonal(rng, 4), pairs).maps
    both = MapEdges(8, np.concatenate([pairs, pairs + 4]), np.concatenate([noisy, perfect]), np.ones(12))
    together = synchronise(both, TRUSTING)
    expected = synchronise(MapEdges(4, pairs, noisy, np.ones(6)), TRUSTING)
    assert alone.residuals.max() > 0.1
    for i, j in pairs.tolist():
        np.testing.assert_allclose(together.functional(i, j), expected.functional(i, j), atol=1e-8)


def test_spanning_tree_is_the_cheapest(rng: np.random.Generator) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import minimum_spanning_tree

    pairs = all_pairs(9)
    cost = rng.uniform(1, 2, len(pairs))
    kept = spanning_tree(9, pairs, cost)
    expected = minimum_spanning_tree(coo_matrix((cost, pairs.T), shape=(9, 9))).sum()
    assert cost[kept].sum() == pytest.approx(expected)
    assert set(components(9, pairs[kept])) == {0}
