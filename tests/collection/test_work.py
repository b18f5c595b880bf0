"""Maps that come from the network instead of a match."""

from __future__ import annotations

import json
import math

import numpy as np
from prepared import MIDDLE, PreparedPair, true_functional_map

from clalign.collection.work import derived_correspondence
from clalign.engine import Reference
from clalign.matching.result import versions


def test_a_map_of_the_network_says_all_that_is_known_of_it(middle: PreparedPair) -> None:
    source, target, truth = middle
    functional = true_functional_map(source.basis, target.basis, truth.source_of_target, 20)
    found = derived_correspondence(source, target, functional, Reference(), MIDDLE)
    assert (found.target_of_source == truth.target_of_source).mean() > 0.8
    facts = json.loads(json.dumps(found.facts()))
    assert (facts["xi"], facts["status"], facts["versions"]) == (MIDDLE.spectrum.xi, "not run", versions())
    assert math.isnan(found.confidence)
    np.testing.assert_array_equal(found.functional_map, functional)
