"""The search for a map of a part's samples to places of the whole.

Every sample has the places that look most like it; what tells them apart is whether distances to the others fit. From
each place of a few samples a soft assignment is annealed towards consistency (a quadratic assignment, softened as in
Gold & Rangarajan 1996), all in one batch; the best different outcomes are improved sample by sample (iterated
conditional modes, Besag 1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.partial.intervals import Floats, Intervals, misfits, tolerances
from clalign.rules.parts import PartSearchRules
from clalign.search.batch import without_duplicates


@dataclass(frozen=True, eq=False)
class Assignments:
    """Candidate maps, best first.

    Attributes
    ----------
    places : (B, S) int64, a place of the whole for every sample of the part.
    scores : (B,) mean misfit of distances, and the look with its weight.
    """

    places: NDArray[np.int64]
    scores: NDArray[np.float64]

    def take(self, chosen: NDArray[np.integer] | list[int]) -> Assignments:
        """Return some of them, in the given order."""
        return Assignments(self.places[chosen], self.scores[chosen])


@dataclass(frozen=True, eq=False)
class Assignment:
    """The problem.

    Attributes
    ----------
    part : (S, S) bounds of the distances among the part's samples.
    whole : (P, P) the same among the places.
    look : (S, P) costs; see `descriptors.look_costs`.
    rules : of the search.
    """

    part: Intervals
    whole: Intervals
    look: NDArray[np.float64]
    rules: PartSearchRules

    def scores(self, places: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the score of every map (B, S)."""
        samples = places.shape[1]
        tolerance = tolerances(self.part.upper, self.rules)
        own = np.arange(samples)
        found = np.empty(len(places))
        for number, each in enumerate(places):
            wrong = misfits(self.part, self.whole.at(each, each), tolerance)
            distances = float(wrong.sum(dtype=np.float64)) / max(samples * (samples - 1), 1)
            found[number] = distances + self.rules.look_score * float(self.look[own, each].mean())
        return found

    def apart(self, places: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return (B, B): mean distance on the whole between the images under two maps."""
        return np.array([self.whole.upper[places, each[None]].mean(axis=1) for each in places], dtype=np.float64)

    def different(self, found: Assignments, radius: float, most: int) -> Assignments:
        """Return the best maps of which none is within a radius of a better one."""
        order = np.argsort(found.scores, kind="stable")
        return found.take(without_duplicates(self.apart(found.places), order, radius, most))

    def ranked(self, places: NDArray[np.int64], radius: float, most: int) -> Assignments:
        """Return the best different ones of some maps (B, S)."""
        unique = np.unique(places, axis=0)
        return self.different(Assignments(unique, self.scores(unique)), radius, most)

    def swept(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return maps (B, S) in which each sample in turn has taken the place that fits the others best."""
        rules, samples = self.rules, places.shape[1]
        tolerance, current = tolerances(self.part.upper, rules), places.copy()
        for number, each in enumerate(current):
            for _ in range(rules.sweeps):
                before = each.copy()
                for sample in range(samples):
                    row = slice(sample, sample + 1)
                    wrong = misfits(
                        Intervals(self.part.lower[row], self.part.upper[row]),
                        Intervals(self.whole.lower[:, each], self.whole.upper[:, each]),
                        tolerance[row],
                    )
                    wrong[:, sample] = 0.0
                    cost = wrong.sum(axis=1) / (samples - 1) + rules.look_score * self.look[sample]
                    each[sample] = int(cost.argmin())
                if np.array_equal(before, each):
                    break
            current[number] = each
        return current


def search(problem: Assignment) -> Assignments:
    """Return the best different maps of the part's samples."""
    rules = problem.rules
    first = problem.ranked(annealed(problem), rules.apart, rules.improved)
    return problem.ranked(problem.swept(first.places), rules.distinct, rules.kept)


def annealed(problem: Assignment) -> NDArray[np.int64]:
    """Return one map (B, S) for every candidate place of each seed, by annealing a soft assignment."""
    rules = problem.rules
    candidates = np.argsort(problem.look, axis=1, kind="stable")[:, : rules.candidates]
    samples, width = candidates.shape
    look = np.take_along_axis(problem.look, candidates, axis=1).astype(np.float32)
    consistency = _consistency(problem, candidates)
    seeds = _seeds(look, problem.part.upper, rules.seeds)
    fixed = np.repeat(seeds, width), np.tile(np.arange(width), len(seeds))
    starts = np.arange(len(fixed[0]))
    prior = np.exp(-rules.look * (look - look.min(axis=1, keepdims=True)))
    soft = np.repeat((prior / prior.sum(axis=1, keepdims=True))[None], len(starts), axis=0)
    _fix(soft, starts, fixed)
    pull = np.zeros_like(soft)
    pull[starts, fixed[0], fixed[1]] = rules.pull * samples
    heat = np.geomspace(rules.coldest, rules.hottest, rules.steps)
    for step in range(rules.steps):
        weighed = soft + pull if step < rules.pulled else soft
        support = (weighed.reshape(len(starts), -1) @ consistency).reshape(soft.shape) / samples
        weight = rules.look if step < rules.steps - rules.last else rules.look_last
        exponent = np.float32(heat[step]) * support - np.float32(weight) * look[None]
        soft = np.exp(exponent - exponent.max(axis=2, keepdims=True))
        soft /= soft.sum(axis=2, keepdims=True)
        if step <= rules.pulled:
            _fix(soft, starts, fixed)
    return candidates[np.arange(samples)[None], soft.argmax(axis=2)]


def _consistency(problem: Assignment, candidates: NDArray[np.int64]) -> Floats:
    """Return (S·K, S·K): how far two candidate matches fit each other; 0 between those of one sample."""
    samples, width = candidates.shape
    flat = candidates.ravel()
    owner = np.repeat(np.arange(samples), width)
    part = problem.part.at(owner, owner)
    fit = 1.0 - misfits(part, problem.whole.at(flat, flat), tolerances(part.upper, problem.rules))
    fit[owner[:, None] == owner[None]] = 0.0
    return fit


def _seeds(look: Floats, distances: Floats, count: int) -> NDArray[np.int64]:
    """Return samples far from each other, the first one that whose best place stands out most among its best ten."""
    chosen = [int((look[:, :10].mean(axis=1) - look[:, 0]).argmax())]
    while len(chosen) < min(count, len(look)):
        chosen.append(int(distances[chosen].min(axis=0).argmax()))
    return np.array(chosen)


def _fix(soft: Floats, starts: NDArray[np.int64], fixed: tuple[NDArray[np.int64], NDArray[np.int64]]) -> None:
    soft[starts, fixed[0]] = 0.0
    soft[starts, fixed[0], fixed[1]] = 1.0
