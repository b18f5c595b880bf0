"""``clalign bench kernels``: rates of the kernels, of one evaluation of the objective, and of the eigensolver."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.bench.common import add_output_arguments, deliver
from clalign.cli.terminal import Terminal
from clalign.data import bundled_pair
from clalign.errors import OptionError
from clalign.options import EngineOptions

if TYPE_CHECKING:
    from clalign.benchmark.kernels import KernelRate, SpectraTimes
    from clalign.benchmark.losses import LossTimes
    from clalign.engine.kernels import Kernels

_DESCRIPTION = """\
Time every kernel beside numpy doing the same work (a matrix product of as many operations for the fused ones) and
beside a copy and a large product on the device, its ceilings; one value and gradient of the objective beside the dense
evaluation with n x n matrices; and the spectra of a shape beside scipy's eigsh. What is compared is timed in turn.
"""

PARTS = ("kernels", "losses", "spectra")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``kernels``."""
    parser = subparsers.add_parser("kernels", help="rates of the kernels on a device", description=_DESCRIPTION)
    parser.add_argument("--quick", action="store_true", help="small sizes only: half a minute instead of several")
    parser.add_argument("--parts", metavar="NAMES", default=",".join(PARTS), help="comma-separated (default: all)")
    parser.add_argument("--device", metavar="SPEC", default="", help="as of 'clalign match'")
    parser.add_argument("--repeat", metavar="N", type=int, default=5, help="the best of N counts (default: 5)")
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "kernels")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure what was asked for and show it."""
    from clalign.benchmark.kernels import kernel_table, spectra_table
    from clalign.benchmark.losses import loss_table
    from clalign.benchmark.performance import this_machine
    from clalign.engine.kernels import open_kernels

    parts = [part.strip() for part in args.parts.split(",")]
    if not set(parts) <= set(PARTS):
        raise OptionError(f"--parts must be of {', '.join(PARTS)}; got {args.parts!r}")
    if args.repeat < 1:
        raise OptionError(f"--repeat must be at least 1, got {args.repeat}")
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    machine, kernels = this_machine(), open_kernels(EngineOptions(device=args.device))
    tables: dict[str, str] = {}
    document: dict[str, Any] = {"device": kernels.device.describe()}
    if "kernels" in parts:
        rates = _kernel_rates(kernels, args, terminal)
        tables[f"Kernels on {kernels.name}"] = kernel_table(rates)
        document["kernels"] = [asdict(rate) | {"ratio": rate.ratio} for rate in rates]
    if "losses" in parts:
        losses = _loss_times(kernels, args, terminal)
        tables["One value and gradient of the objective, random arrays"] = loss_table(losses)
        document["losses"] = asdict(losses) | {"ratio": losses.ratio, "exponent": losses.exponent}
    if "spectra" in parts:
        spectra = _spectra_times(args, terminal)
        tables["Spectra of the bundled shape"] = spectra_table(spectra)
        document["spectra"] = asdict(spectra) | {"ratio": spectra.ratio}
    deliver(tables, document, machine, args, terminal)
    return 0


def _kernel_rates(kernels: Kernels, args: argparse.Namespace, terminal: Terminal) -> list[KernelRate]:
    from clalign.benchmark.kernels import SIZES, measure_kernels

    rates = []
    for rate in measure_kernels(kernels, SIZES[:1] if args.quick else SIZES, args.repeat):
        rates.append(rate)
        terminal.note(f"{rate.kernel} {rate.size}: {rate.rate:.1f} {rate.unit}, {rate.ratio:.2f} of {rate.other}")
    return rates


def _loss_times(kernels: Kernels, args: argparse.Namespace, terminal: Terminal) -> LossTimes:
    from clalign.benchmark import losses

    terminal.note("value and gradient of the objective")
    if args.quick:
        return losses.measure_losses(kernels, losses.QUICK_SIZES, losses.QUICK_DENSE_SIZE, repeats=args.repeat)
    return losses.measure_losses(kernels, repeats=args.repeat)


def _spectra_times(args: argparse.Namespace, terminal: Terminal) -> SpectraTimes:
    from clalign.benchmark.kernels import measure_spectra
    from clalign.mesh.mesh import load_mesh

    terminal.note("spectra of a shape")
    mesh = load_mesh(bundled_pair().source)
    if args.quick:
        return measure_spectra(mesh, 60, 120, repeats=1)
    return measure_spectra(mesh)
