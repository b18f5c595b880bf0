"""Every operation with the kernels of GPUs once, in a simulator that watches each access to memory (Oclgrind).

``python tools/gpu_races.py`` reports data races, accesses outside of buffers and barriers that not all work-items
reach, and exits with 1 if there are any or if a result differs from numpy's. It takes some minutes.

Needs ``apt install oclgrind``. Buffers get no slack behind them, which the kernels of GPUs must not need.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from clalign.engine import device as device_module
from clalign.engine.band import Band
from clalign.engine.device import Device, DeviceArray
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference, pair_count

LIBRARY = "/usr/lib/oclgrind/liboclgrind-rt-icd.so"
LOG = "OCLGRIND_LOG"
TOLERANCE = 1e-5
"""Largest error, in units of the largest entry of a result."""

Call = tuple[str, tuple[Any, ...], dict[str, Any]]


def calls() -> Iterator[Call]:
    """Yield operations with arguments just larger than one tile."""
    rng = np.random.default_rng(0)
    n, n_y, k, r = 131, 67, 9, 5
    c, psi, w, u = rng.normal(size=(n, k)), rng.normal(size=(n_y, k)), rng.random(n_y), rng.normal(size=(n_y, r))
    dz, packed, left = rng.normal(size=(n, r)), rng.normal(size=(pair_count(k), r)), rng.normal(size=(k, 2 * k))
    exact = Reference()
    z, s = exact.soft_map(c, packed)
    streamed = exact.soft_map_streamed(c, psi, w, u)
    yield "product", (c, psi), {"transpose_b": True}
    yield "product", (c, dz), {"transpose_a": True}
    rows = np.arange(67)
    band = Band.from_limits(np.maximum(rows - 20, 0), np.minimum(rows + 16, 67))
    square = exact.band_expand(rng.normal(size=band.count), band)
    yield "banded_product", (square, square), {"left": band, "right": band}
    yield "weighted_gram", (psi, u, w), {}
    yield "weighted_gram", (np.concatenate([c] * 5), np.concatenate([dz] * 5)), {}
    yield "solve_right", (left @ left.T, c, 1e-3), {}
    yield "packed_moments", (psi, w, u), {}
    yield "packed_moments_gradient", (psi, w, packed), {}
    yield "soft_map", (c, packed, left @ left.T), {}
    yield "soft_map_gradient", (c, packed, left @ left.T, *exact.soft_map(c, packed, left @ left.T), dz), {}
    yield "soft_map_gradient", (c, packed, None, z, s, dz), {}
    yield "soft_map_streamed", (c, psi, w, u), {}
    yield "soft_map_streamed_gradient", (c, psi, w, u, *streamed, dz), {}
    yield "nearest", (c, psi, w), {}
    yield "soft_map_argmax", (c, psi, w), {}
    dx, dy, index = rng.random((20, 20)), rng.random((37, 37)), rng.integers(0, 20, size=(37, 11))
    for floor in (None, 0.05):
        yield "distortion_batch", (dx, dy, rng.random(37), index, floor), {}
    yield "map_distance", (dx, rng.random(37), index), {}
    yield "scale_rows", (c, rng.random(n)), {}
    yield "gather", (c, rng.integers(0, n, size=50)), {}
    yield "half_squares", (c,), {}
    yield "reciprocal", (w,), {}
    yield "transpose", (c,), {}
    yield "band_gather", (square, band), {}
    yield "alignment", (square, np.ascontiguousarray(square.T), square, square, square, band, True), {}
    yield "total", (rng.random(5000),), {}


def difference(kernels: Kernels, call: Call) -> float:
    """Return the largest difference from the double precision twin, in units of the largest entry."""
    name, arguments, options = call
    rounded = [np.asarray(a, np.float32) if _is_real(a) else a for a in arguments]
    given = [kernels.array(a) if isinstance(a, np.ndarray) else a for a in rounded]
    exact = [Reference().array(a) if isinstance(a, np.ndarray) else a for a in rounded]
    found, true = (getattr(side, name)(*values, **options) for side, values in ((kernels, given), (Reference(), exact)))
    pairs = zip(found, true, strict=True) if isinstance(found, tuple) else [(found, true)]
    worst = 0.0
    for part, whole in pairs:
        values = part.get() if isinstance(part, DeviceArray) else np.asarray(part)
        inside = slice(None)
        if name == "alignment" and values.ndim == 2:
            inside = arguments[5].positions
        error = np.abs(values[inside] - whole[inside]).max() if values.ndim else abs(float(values) - float(whole))
        worst = max(worst, float(error / max(np.abs(whole).max(), 1e-30)))
    return worst


def _is_real(argument: Any) -> bool:
    return isinstance(argument, np.ndarray) and argument.dtype.kind == "f"


def run_all() -> int:
    """Run every operation on the simulator, in the process that was started for it."""
    device_module.SLACK = 0
    kernels = Kernels(Device("oclgrind", kind="gpu"))
    wrong = False
    for call in calls():
        error = difference(kernels, call)
        wrong = wrong or not error <= TOLERANCE
        sys.stdout.write(f"{call[0]}: off by {error:.0e}\n")
        sys.stdout.flush()
    return int(wrong)


def main() -> int:
    """Start the simulator in a process of its own, and print what it has found when that is over."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", default=LIBRARY, help="Oclgrind's driver (default: %(default)s)")
    args = parser.parse_args()
    if LOG in os.environ:
        return run_all()
    if not Path(args.library).is_file():
        raise SystemExit(f"{args.library} is missing: apt install oclgrind")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        log.touch()
        (Path(folder) / "oclgrind.icd").write_text(args.library, encoding="utf-8")
        # The simulator counts the local memory of all kernels of a program together.
        settings = {"OCLGRIND_DATA_RACES": "1", "OCLGRIND_LOCAL_MEM_SIZE": str(1 << 17), LOG: str(log)}
        environment = {**os.environ, "OCL_ICD_VENDORS": folder, **settings}
        done = subprocess.run([sys.executable, __file__], env=environment, check=False)
        said = log.read_text(encoding="utf-8", errors="replace").strip()
    sys.stdout.write(f"{said[:5000] or 'no data race, and no access outside of a buffer'}\n")
    return 1 if said or done.returncode else 0


if __name__ == "__main__":
    sys.exit(main())
