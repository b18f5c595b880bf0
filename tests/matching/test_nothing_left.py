"""A process that matches many pairs must not grow: what a match has made goes when its result goes."""

from __future__ import annotations

import gc

import numpy as np
from prepared import MIDDLE, PreparedPair

from clalign.alignment.objective import Objective
from clalign.engine import Backend
from clalign.engine.device import DeviceArray
from clalign.matching.loop import Clock, run_stages
from clalign.matching.state import MatchState
from clalign.search.batch import SamplePair

KINDS = (Objective, SamplePair, DeviceArray)


def alive() -> list[int]:
    gc.collect()
    return [sum(isinstance(each, kind) for each in gc.get_objects()) for kind in KINDS]


def test_a_match_leaves_nothing_behind(middle: PreparedPair, kernels: Backend) -> None:
    def match() -> None:
        options = MIDDLE.replace({"alignment.outer_iterations": 1, "alignment.iterations": 3})
        with np.errstate(all="ignore"):
            run_stages(MatchState(middle.source, middle.target, options, 0.3), kernels, Clock())

    match()  # scratch and constants of the device stay with it
    before = alive()
    match()
    assert alive() == before
