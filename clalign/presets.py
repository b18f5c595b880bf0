"""Named sets of changes to the default options."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "fast": {
        "spectrum.scale_invariant": 200,
        "geodesics.search_samples": 500,
        "alignment.outer_iterations": 0,
        "readout.steps": 2,
    },
    "paper": {
        "spectrum.refinement": 120,
        "spectrum.smoothing": 0.0,
        "search.method": "random",
        "alignment.weights": "uniform",
        "alignment.denominator": "fixed",
        "alignment.unitarity": 0.0,
        "alignment.decay": 1.0,
        "alignment.samples": 0,
        "alignment.outer_iterations": 20,
        "alignment.iterations": 50,
        "readout.refine": "none",
        "readout.steps": 0,
        "readout.readout": "argmax",
    },
}
