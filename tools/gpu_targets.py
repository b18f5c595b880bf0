"""What the kernels reach on a GPU, beside PyTorch on the same card where that is installed.

``python tools/gpu_targets.py --out FILE [--device SPEC] [--small]`` times, each the best of several and queued a few at
a time: products, Gram matrices, the soft map and its gradient beside a product of as many operations, nearest points
beside product and arg-max in tiles, and one value and gradient of the objective. PyTorch computes in float32, TF32 off.
``--small`` divides the lengths by ten, for a trial on a CPU.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clalign.benchmark.losses import ProblemSize, synthetic_problem
from clalign.engine.device import Device
from clalign.engine.kernels import Kernels
from clalign.engine.reference import pair_count

Run = Callable[[], object]
QUEUED = 5
"""Runs that are queued before the host waits for them."""
ROUNDS = 5
TILE = 4096
"""Queries of a tile of PyTorch's nearest points: all scores of 50,000 would not fit."""


@dataclass(frozen=True)
class Target:
    """A measurement, and the share of the reference's rate that is aimed at.

    Attributes
    ----------
    name, size : what was measured.
    operations : that the result needs.
    seconds, reference_seconds : ours and PyTorch's; the latter None where it is not installed.
    wanted : PyTorch's time over ours that is aimed at.
    """

    name: str
    size: str
    operations: float
    seconds: float
    reference_seconds: float | None
    wanted: float

    @property
    def reached(self) -> float | None:
        """PyTorch's time over ours."""
        return None if self.reference_seconds is None else self.reference_seconds / self.seconds


def best_seconds(run: Run, wait: Callable[[], object]) -> float:
    """Return the seconds of one run: the best of several rounds of queued runs, after one to build and warm up."""
    run()
    wait()
    best = float("inf")
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(QUEUED):
            run()
        wait()
        best = min(best, (time.perf_counter() - start) / QUEUED)
    return best


def torch_on_gpu() -> Any:
    """Return PyTorch, or None where it or its GPU is missing."""
    try:
        import torch
    except ImportError:
        return None
    if not torch.cuda.is_available():
        return None
    torch.backends.cuda.matmul.allow_tf32 = False
    return torch


class Bench:
    """Pairs of runs on one device."""

    def __init__(self, kernels: Kernels) -> None:
        self.kernels, self.torch = kernels, torch_on_gpu()
        self._rng = np.random.default_rng(0)

    def array(self, *shape: int) -> Any:
        """Return random numbers on the device."""
        return self.kernels.array(self._rng.standard_normal(shape, dtype=np.float32))

    def target(self, name: str, size: str, operations: float, wanted: float, ours: Run, other: Run | None) -> Target:
        """Time ours, and the reference if there is one."""
        seconds = best_seconds(ours, self.kernels.device.finish)
        reference = None
        if self.torch is not None and other is not None:
            reference = best_seconds(other, self.torch.cuda.synchronize)
        return Target(name, size, operations, seconds, reference, wanted)

    def torch_product(self, m: int, n: int, depth: int) -> Run | None:
        """Return PyTorch's product of random matrices (m, depth) and (depth, n)."""
        if self.torch is None:
            return None
        a, b = (self.torch.randn(shape, device="cuda") for shape in ((m, depth), (depth, n)))
        out = self.torch.empty((m, n), device="cuda")
        return lambda: self.torch.mm(a, b, out=out)

    def torch_nearest(self, m: int, p: int, depth: int) -> Run | None:
        """Return PyTorch's nearest points, in tiles of queries."""
        if self.torch is None:
            return None
        queries, points = (self.torch.randn((rows, depth), device="cuda") for rows in (m, p))
        penalty = 0.5 * (points**2).sum(1)
        return lambda: [(queries[i : i + TILE] @ points.T - penalty).argmax(1) for i in range(0, m, TILE)]


def products(bench: Bench, divisor: int) -> Iterator[Target]:
    """Time products and Gram matrices."""
    kernels = bench.kernels
    for m, n, depth, wanted in ((4096, 4096, 4096, 0.6), (6890, 352, 352, 0.5)):
        size = tuple(max(length // divisor, 8) for length in (m, n, depth))
        a, b, out = bench.array(size[0], size[2]), bench.array(size[2], size[1]), kernels.zeros(size[:2])
        run = functools.partial(kernels.product, a, b, out=out)
        operations = 2.0 * np.prod(size)
        yield bench.target("product", "x".join(map(str, size)), operations, wanted, run, bench.torch_product(*size))
    rows, p, q = 50_000 // divisor, 352 // divisor, 120 // divisor
    x, y, w, gram = bench.array(rows, p), bench.array(rows, q), bench.array(rows), kernels.zeros((p, q))
    ours: Run = lambda: kernels.weighted_gram(x, y, w, out=gram)  # noqa: E731
    yield bench.target(
        "weighted_gram", f"{p}x{q}x{rows}", 2.0 * rows * p * q, 0.5, ours, bench.torch_product(p, q, rows)
    )


def soft_maps(bench: Bench, divisor: int) -> Iterator[Target]:
    """Time the soft map and its gradient beside a product of as many operations."""
    kernels, n, k, r = bench.kernels, 50_000 // divisor, 120, 50
    pairs = pair_count(k)
    c, packed, dz = bench.array(n, k), bench.array(pairs, r), bench.array(n, r)
    z, s, dc = kernels.zeros((n, r)), kernels.zeros(n), kernels.zeros((n, k))
    equal, work, size = bench.torch_product(n, r, pairs), 2.0 * n * pairs * r, f"n={n} k={k} r={r}"
    forward: Run = lambda: kernels.soft_map(c, packed, out=(z, s))  # noqa: E731
    backward: Run = lambda: kernels.soft_map_gradient(c, packed, None, z, s, dz, out=dc)  # noqa: E731
    yield bench.target("soft_map", size, work, 0.7, forward, equal)
    yield bench.target("soft_map_gradient", size, work, 0.7, backward, equal)


def nearest(bench: Bench, divisor: int) -> Iterator[Target]:
    """Time the nearest points among eigenfunctions."""
    kernels, n, depth = bench.kernels, 50_000 // divisor, 352
    queries, points = bench.array(n, depth), bench.array(n, depth)
    penalty, found = kernels.half_squares(points), (kernels.zeros(n, np.int32), kernels.zeros(n))
    run: Run = lambda: kernels.nearest(queries, points, penalty, out=found)  # noqa: E731
    yield bench.target("nearest", f"{n}x{n}x{depth}", 2.0 * n * n * depth, 1.0, run, bench.torch_nearest(n, n, depth))


def evaluations(bench: Bench, divisor: int) -> Iterator[Target]:
    """Time one value and gradient, which wait for the device themselves."""
    n, size = 6890 // divisor, ProblemSize()
    problem, frozen, x = synthetic_problem(bench.kernels, n, size)
    run: Run = lambda: problem.value_and_gradient(x, frozen)  # noqa: E731
    work = 4.0 * n * pair_count(size.basis) * size.rank
    yield bench.target("value_and_gradient", f"n={n} k={size.basis} d={size.scale_invariant}", work, 0.0, run, None)


def main() -> int:
    """Time everything; the document is written after every row, so that a limit of time loses only the rest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, metavar="FILE", required=True, help="the JSON document")
    parser.add_argument("--device", metavar="SPEC", default="", help="as of 'clalign match'")
    parser.add_argument("--small", action="store_true", help="a tenth of the lengths")
    args = parser.parse_args()
    bench, divisor = Bench(Kernels(Device(args.device))), 10 if args.small else 1
    torch = bench.torch
    document: dict[str, Any] = {
        "device": bench.kernels.describe(),
        "pytorch": None if torch is None else f"{torch.__version__} on {torch.cuda.get_device_name()}",
        "targets": [],
    }
    for part in (products, evaluations, soft_maps, nearest):
        for target in part(bench, divisor):
            document["targets"].append(asdict(target) | {"reached": target.reached})
            args.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            rate = target.operations / target.seconds / 1e9
            beside = "" if target.reached is None else f", {target.reached:.2f} of PyTorch (aim {target.wanted})"
            sys.stdout.write(
                f"{target.name} {target.size}: {1e3 * target.seconds:.3f} ms, {rate:.1f} GFLOP/s{beside}\n"
            )
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
