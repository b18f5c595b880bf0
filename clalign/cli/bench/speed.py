"""``clalign bench kernels|pair|scale|forecast``: rates of the kernels, time and memory of whole matches."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clalign.cli.bench.common import add_option_arguments, add_output_arguments, deliver
from clalign.cli.match import option_changes
from clalign.cli.terminal import Terminal
from clalign.data import bundled_pair
from clalign.errors import OptionError
from clalign.options import Options
from clalign.presentation import PAGE_FILE, PICTURE_FILE
from clalign.storage.files import write_text

_KERNELS = """\
Time every kernel beside numpy doing the same work (a matrix product of as many operations for the fused ones) and
beside a copy and a large product on the device, its ceilings; one value and gradient of the objective beside the dense
evaluation with n x n matrices; and the spectra of a shape beside scipy's eigsh. What is compared is timed in turn.
"""

PARTS = ("kernels", "losses", "spectra")


def add_kernels(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``kernels``."""
    parser = subparsers.add_parser("kernels", help="rates of the kernels on a device", description=_KERNELS)
    parser.add_argument("--quick", action="store_true", help="small sizes only: half a minute instead of several")
    parser.add_argument("--parts", metavar="NAMES", default=",".join(PARTS), help="comma-separated (default: all)")
    parser.add_argument("--device", metavar="SPEC", default="", help="as of 'clalign match'")
    parser.add_argument(
        "--device-class", choices=["auto", "cpu", "gpu"], default="auto", help="kernels of CPUs or of GPUs"
    )
    parser.add_argument("--repeat", metavar="N", type=int, default=5, help="the best of N counts (default: 5)")
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "kernels")
    parser.set_defaults(run=run_kernels)


def run_kernels(args: argparse.Namespace) -> int:
    """Measure what was asked for and show it."""
    from clalign.benchmark import losses
    from clalign.benchmark.kernels import SIZES, kernel_table, measure_kernels, measure_spectra, spectra_table
    from clalign.benchmark.performance import this_machine
    from clalign.engine.device import Device
    from clalign.engine.kernels import Kernels
    from clalign.mesh.mesh import load_mesh

    parts = [part.strip() for part in args.parts.split(",")]
    if not set(parts) <= set(PARTS):
        raise OptionError(f"--parts must be of {', '.join(PARTS)}; got {args.parts!r}")
    if args.repeat < 1:
        raise OptionError(f"--repeat must be at least 1, got {args.repeat}")
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    machine, kernels = this_machine(), Kernels(Device(args.device, kind=args.device_class))
    tables: dict[str, str] = {}
    document: dict[str, Any] = {"device": kernels.device.describe()}
    if "kernels" in parts:
        rates = []
        for rate in measure_kernels(kernels, SIZES[:1] if args.quick else SIZES, args.repeat):
            rates.append(rate)
            terminal.note(f"{rate.kernel} {rate.size}: {rate.rate:.1f} {rate.unit}, {rate.ratio:.2f} of {rate.other}")
        tables[f"Kernels on {kernels.name}"] = kernel_table(rates)
        document["kernels"] = [asdict(rate) | {"ratio": rate.ratio} for rate in rates]
    if "losses" in parts:
        terminal.note("value and gradient of the objective")
        if args.quick:
            sizes, dense = losses.QUICK_SIZES, losses.QUICK_DENSE_SIZE
            times = losses.measure_losses(kernels, sizes, dense, repeats=args.repeat)
        else:
            times = losses.measure_losses(kernels, repeats=args.repeat)
        tables["One value and gradient of the objective, random arrays"] = losses.loss_table(times)
        document["losses"] = asdict(times) | {"ratio": times.ratio, "exponent": times.exponent}
    if "spectra" in parts:
        terminal.note("spectra of a shape")
        mesh = load_mesh(bundled_pair().source)
        spectra = measure_spectra(mesh, 60, 120, repeats=1) if args.quick else measure_spectra(mesh)
        tables["Spectra of the bundled shape"] = spectra_table(spectra)
        document["spectra"] = asdict(spectra) | {"ratio": spectra.ratio}
    deliver(tables, document, machine, args, terminal)
    return 0


_PAIR = """\
Match two meshes in processes of their own: once as on a new machine, where OpenCL programs are built too, then in
turn with an empty and a filled cache of shapes. A time runs from the start of the process to its end.
"""


def add_pair(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``pair``."""
    parser = subparsers.add_parser("pair", help="time and memory of a whole match", description=_PAIR)
    parser.add_argument("source", metavar="SOURCE", type=Path, nargs="?", help="mesh file (default: the bundled pair)")
    parser.add_argument("target", metavar="TARGET", type=Path, nargs="?", help="mesh file")
    parser.add_argument("--peer", choices=["pyfm"], help="let pyFM match the pair in the same rounds")
    parser.add_argument("--repeat", metavar="N", type=int, default=3, help="rounds; the median counts (default: 3)")
    add_option_arguments(parser)
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "pair")
    parser.set_defaults(run=run_pair)


def run_pair(args: argparse.Namespace) -> int:
    """Time the pair and show the table."""
    from clalign.benchmark.pair import measure_pair, pair_table
    from clalign.benchmark.peers import PyfmMethod
    from clalign.benchmark.performance import bytes_text, this_machine
    from clalign.mesh.mesh import load_mesh

    if (args.source is None) != (args.target is None):
        raise OptionError("give both SOURCE and TARGET, or neither for the bundled pair")
    if args.repeat < 1:
        raise OptionError(f"--repeat must be at least 1, got {args.repeat}")
    bundled = bundled_pair()
    files = (args.source or bundled.source, args.target or bundled.target)
    counts = [load_mesh(file).n_vertices for file in files]
    if args.peer is not None:
        # Says how to install it, before the long work.
        _ = PyfmMethod().settings
    options = Options.preset(args.preset).replace(option_changes(args))
    terminal, machine = Terminal(quiet=args.quiet, as_json=args.json), this_machine()
    times = measure_pair(
        *files,
        options,
        args.repeat,
        args.peer is not None,
        lambda one: terminal.note(f"{one.label}: {one.seconds:.1f} s, {bytes_text(one.peak)}"),
    )
    heading = f"{files[0].stem} ({counts[0]:,} vertices) to {files[1].stem} ({counts[1]:,}) on {times[0].device}"
    document = {
        "source": str(files[0]),
        "target": str(files[1]),
        "vertices": counts,
        "options": options.as_dict(),
        "runs": [asdict(one) for one in times],
    }
    short = f"{heading}\n\n{pair_table(times, stages=False)}"
    deliver({heading: pair_table(times)}, document, machine, args, terminal, short)
    return 0


SIZES = "5000,10000,20000,50000,100000,200000"

_SCALE = """\
Match generated pairs (one bumpy body in two poses, each meshed in its own random way) of growing size, each in a
process of its own without a cache of shapes; OpenCL programs are built beforehand. The table has the seconds of each
stage, the peak memory, the mean distance to the true vertex (x 100, in sqrt(area)) and the fitted exponents.
"""


def add_scale(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``scale``."""
    parser = subparsers.add_parser("scale", help="time and memory over the number of vertices", description=_SCALE)
    parser.add_argument(
        "--sizes",
        metavar="NUMBERS",
        default=SIZES,
        help="vertices of each mesh, comma-separated (default: %(default)s)",
    )
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw the times into a PNG, SVG or PDF file")
    add_option_arguments(parser)
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "scale")
    parser.set_defaults(run=run_scale)


def run_scale(args: argparse.Namespace) -> int:
    """Time all sizes and show the table."""
    from clalign.benchmark.pair import measure_scale, scale_table, stage_exponents
    from clalign.benchmark.performance import bytes_text, this_machine
    from clalign.presentation.curves import save_scale_plot

    sizes = parsed_sizes(args.sizes)
    options = Options.preset(args.preset).replace(option_changes(args))
    terminal, machine = Terminal(quiet=args.quiet, as_json=args.json), this_machine()
    times = measure_scale(
        sizes,
        options,
        args.seed,
        lambda one: terminal.note(f"{one.time.label}: {one.time.seconds:.1f} s, {bytes_text(one.time.peak)}"),
    )
    document = {
        "options": options.as_dict(),
        "runs": [asdict(one) for one in times],
        "exponents": stage_exponents(times),
    }
    deliver({f"Generated pairs on {times[0].time.device}": scale_table(times)}, document, machine, args, terminal)
    if args.plot is not None:
        save_scale_plot(times, args.plot, title=times[0].time.device)
    return 0


def parsed_sizes(text: str) -> list[int]:
    """Return the numbers of a comma-separated list, ascending.

    Raises
    ------
    OptionError
        Something in it is not a positive whole number.
    """
    from clalign.benchmark.generated import SMALLEST

    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() and int(word) >= SMALLEST for word in words):
        raise OptionError(f"--sizes must be whole numbers of at least {SMALLEST}, comma-separated; got {text!r}")
    return sorted({int(word) for word in words})


_FORECAST = """\
Match generated pairs of growing size, one of them with other options too, and the bundled pair, each in a process of
its own; fit the coefficients of the forecast to peak memory and processor time; and write them with the measurements
to a file, by default the one that this installation reads. It takes some six minutes on two processors. Other
programs meanwhile change the memory not at all and the processor time little.
"""


def add_forecast(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``forecast``."""
    parser = subparsers.add_parser("forecast", help="calibrate the forecast of memory and time", description=_FORECAST)
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the coefficients to FILE instead")
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.set_defaults(run=run_forecast)


def run_forecast(args: argparse.Namespace) -> int:
    """Measure, fit and write."""
    from clalign import resources
    from clalign.benchmark.calibration import Measured, measurements, table
    from clalign.benchmark.performance import bytes_text, this_machine

    terminal, machine = Terminal(quiet=args.quiet), this_machine()
    out = args.out or resources.TABLE

    def watch(one: Measured) -> None:
        changes = ", ".join(f"{name}={value}" for name, value in one.changes.items()) or "default options"
        label = f"{one.name}, {one.vertices[0]:,} vertices, {changes}"
        terminal.note(f"{label}: {bytes_text(one.memory)}, {sum(one.work.values()):.1f} s of a processor")

    found = measurements(draw, watch)
    text = json.dumps(table(found, machine), indent=1)
    write_text(out, text + "\n")
    terminal.say(f"wrote {out}")
    return 0


def draw(result: Any, folder: Path) -> None:
    """Draw what ``clalign match`` draws."""
    from clalign.presentation.picture import save_match_picture
    from clalign.presentation.report import write_report

    save_match_picture(result, folder / PICTURE_FILE)
    write_report(result, folder / PAGE_FILE)
