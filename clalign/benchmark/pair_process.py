"""One match in a process of its own, for `clalign.benchmark.pair`.

``python -m clalign.benchmark.pair_process REQUEST.json`` prints a JSON document with the seconds of the match, those
of its stages and the most memory that the process and its helpers held.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.memory import PeakMemory, processor_seconds


@dataclass(frozen=True)
class Request:
    """What to match and how.

    source, target : mesh files.
    method : "clalign" or "pyfm".
    options : nested plain values as of `Options.as_dict`; for "clalign".
    cache : folder of the shape cache, or "" to compute everything.
    map : ``.npy`` file for the target vertex of every source vertex, or "".
    """

    source: str
    target: str
    method: str
    options: dict[str, Any]
    cache: str = ""
    map: str = ""


def run(request: Request) -> dict[str, Any]:
    """Match, and return "seconds", "stages", "work" (processor seconds), "device" and "peak" (bytes, or None).

    Work and peak are those of this process and of the processes that it starts, as `PeakMemory` says; on Windows the
    work is that of this process alone, whose system does not add up that of others.
    """
    start = time.perf_counter()
    match = _clalign if request.method == "clalign" else _pyfm
    with PeakMemory() as memory:
        target_of_source, stages, device = match(request)
    seconds = time.perf_counter() - start
    if request.map:
        np.save(request.map, target_of_source)
    work = processor_seconds()
    return {"seconds": seconds, "stages": stages, "work": work, "device": device, "peak": memory.peak}


def _clalign(request: Request) -> tuple[NDArray[np.int64], dict[str, float], str]:
    from clalign.geometry.cache import ShapeCache
    from clalign.matching.pair import match
    from clalign.options import Options

    cache = ShapeCache(Path(request.cache)) if request.cache else None
    result = match(request.source, request.target, Options.from_dict(request.options), cache=cache)
    return result.target_of_source, result.timings, result.device


def _pyfm(request: Request) -> tuple[NDArray[np.int64], dict[str, float], str]:
    from clalign.benchmark.pairs import LoadedPair
    from clalign.benchmark.peers import PyfmMethod
    from clalign.evaluation.truth import Truth
    from clalign.mesh.mesh import load_mesh

    start = time.perf_counter()
    source, target = load_mesh(request.source), load_mesh(request.target)
    read = time.perf_counter() - start
    outcome = PyfmMethod()(LoadedPair("pair", source, target, Truth.unknown(), None))
    return outcome.target_of_source, {"read": read, **outcome.stages}, f"numpy {np.__version__}"


if __name__ == "__main__":
    sys.stdout.write(json.dumps(run(Request(**json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))) + "\n")
