"""Registers, spills, private memory and occupancy of the kernels of GPUs, from NVIDIA's assembler and without a card.

``python tools/gpu_registers.py`` compiles every program as `clalign.engine.device_class` has it built, and prints a
table; ``--update docs/benchmarks.md`` puts it there. Exit status 1 if a kernel spills, has a private stack, or fills
less than a quarter of a unit. NVIDIA's own OpenCL compiler may differ a little.

Needs ``clang-15`` and ``libclc-15`` (``apt install clang-15 libclc-15``), and ``ptxas`` of the CUDA tools on the path
or in the environment (``pip install nvidia-cuda-nvcc-cu12``).
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from clalign.benchmark.table import markdown_table, replace_section
from clalign.engine.device_class import GPU, GPU_DOUBLE, GpuClass
from clalign.engine.gpu_arrays import PART, TRANSPOSE_BLOCK
from clalign.engine.launching import distortion_definitions
from clalign.engine.programs import kernel_source, program_names

BITCODE = Path("/usr/lib/clc/nvptx64--nvidiacl.bc")
FRONT_END = "sm_80"
"""Architecture that clang-15 compiles for: it knows no later one, for which ptxas then assembles the same code."""

LOCAL_MEMORY = {"sm_80": 164 * 1024, "sm_90": 228 * 1024}
"""Bytes of local memory of a unit, by architecture."""
REGISTERS = 65536
WARPS = 64
WARP = 32
LEAST_OCCUPANCY = 0.25
SECTION = "registers"


@dataclass(frozen=True)
class Usage:
    """What one kernel needs on one architecture: registers and bytes of a work-item, bytes of a work-group.

    Attributes
    ----------
    program, variant, kernel, architecture : names.
    registers, stack, spilled : of a work-item; bytes but for the first.
    local : bytes of local memory of a work-group.
    """

    program: str
    variant: str
    kernel: str
    architecture: str
    registers: int
    stack: int
    spilled: int
    local: int

    @property
    def occupancy(self) -> float:
        """Share of the warps of a unit that registers and local memory leave room for, in whole work-groups."""
        # Registers are given out in eights to a work-item; a work-group takes a kilobyte of local memory for itself.
        group = GPU.work_group // WARP
        by_registers = REGISTERS // (-(-self.registers // 8) * 8 * WARP * group)
        by_local = LOCAL_MEMORY[self.architecture] // (self.local + 1024)
        return min(by_registers, by_local, WARPS // group) * group / WARPS

    @property
    def good(self) -> bool:
        """Whether nothing of it lies in private memory, and enough work-items are at hand."""
        return not self.stack and not self.spilled and self.occupancy >= LEAST_OCCUPANCY


def variants(constants: GpuClass, precision: str) -> Iterator[tuple[str, str, dict[str, str | int]]]:
    """Yield program, name of the variant, and its ``-D`` definitions."""
    tiles = {
        "gpu_product": {"large": constants.large, "small": constants.small},
        "gpu_soft_map": {"": constants.soft_map},
        "gpu_soft_map_gradient": {"": constants.gradient},
        "gpu_soft_map_streamed": {"": constants.streamed},
        "gpu_best": {"": constants.best},
        "gpu_distortion": {"": constants.core},
    }
    item_bytes = 8 if precision == "double" else 4
    common = {"PRECISION": 8 * item_bytes, **constants.definitions(item_bytes)}
    for program in program_names():
        if program in tiles:
            unroll = constants.streamed_unroll if program == "gpu_soft_map_streamed" else constants.unroll
            # Where two tiles are the same, one of them is enough.
            for tile, name in {tile: name for name, tile in tiles[program].items()}.items():
                label = " ".join(filter(None, (precision, name)))
                yield program, label, {**common, **tile.definitions, "UNROLL": unroll}
        elif program.startswith("gpu_"):
            extra: dict[str, str | int] = {"RB": PART, "TB": TRANSPOSE_BLOCK}
            yield program, precision, {**common, **extra, **distortion_definitions(0.05, item_bytes)}


def usages(program: str, variant: str, defines: dict[str, str | int], folder: Path) -> Iterator[Usage]:
    """Compile a program and yield what each of its kernels needs on each architecture."""
    source = kernel_source(program, defines)
    text, assembly = folder / "k.cl", folder / "k.ptx"
    text.write_text(source.text, encoding="utf-8")
    front_end = ["-target-cpu", FRONT_END, "-finclude-default-header", "-mlink-builtin-bitcode", str(BITCODE)]
    command = ["clang-15", "-x", "cl", "-cl-std=CL1.2", "-O3", "-target", "nvptx64-nvidia-nvcl"]
    command += [word for option in front_end for word in ("-Xclang", option)]
    run([*command, *source.options, "-S", "-o", str(assembly), str(text)])
    for architecture in LOCAL_MEMORY:
        said = run([assembler(), "-v", f"-arch={architecture}", str(assembly), "-o", str(folder / "k.cubin")])
        for entry in said.split("Compiling entry function '")[1:]:
            stack, spilled = (int(number) for number in re.findall(r"(\d+) bytes (?:stack frame|spill stores)", entry))
            registers, local = (re.search(rf"(\d+) {what}", entry) for what in ("registers", "bytes smem"))
            sizes = (int(registers[1]) if registers else 0, stack, spilled, int(local[1]) if local else 0)
            yield Usage(program, variant, entry.split("'")[0], architecture, *sizes)


def assembler() -> str:
    """Return the path of ptxas."""
    wheel = Path(sys.prefix).glob("lib/python*/site-packages/nvidia/cuda_nvcc/bin/ptxas")
    found = shutil.which("ptxas") or next(map(str, wheel), None)
    if found is None:
        raise SystemExit("ptxas is missing: pip install nvidia-cuda-nvcc-cu12")
    return found


def run(command: list[str]) -> str:
    """Run a compiler and return what it says; leave with its message if it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise SystemExit(f"{command[0]} is missing: apt install clang-15 libclc-15") from None
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout + done.stderr


def table(found: list[Usage]) -> str:
    """Return the Markdown table: a row a kernel, both architectures in each cell."""
    rows = []
    for key in dict.fromkeys((each.program, each.variant, each.kernel) for each in found):
        same = [each for each in found if (each.program, each.variant, each.kernel) == key]
        columns = [[str(getattr(each, name)) for each in same] for name in ("registers", "stack", "spilled", "local")]
        columns.append([f"{each.occupancy:.0%}" for each in same])
        cells = [column[0] if len(set(column)) == 1 else " / ".join(column) for column in columns]
        rows.append([f"`{key[0]}`", key[1], f"`{key[2]}`", *cells])
    header = ["program", "variant", "kernel", "registers", "private bytes", "spilled bytes", "local bytes", "occupancy"]
    return markdown_table(header, rows, text_columns=3)


def main() -> int:
    """Compile everything, print the table, and tell whether all is well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--update", type=Path, metavar="FILE", help=f"put the table into section {SECTION} of FILE")
    args = parser.parse_args()
    found: list[Usage] = []
    with tempfile.TemporaryDirectory() as folder:
        for precision, constants in (("single", GPU), ("double", GPU_DOUBLE)):
            for program, variant, defines in variants(constants, precision):
                found += usages(program, variant, defines, Path(folder))
    text = table(found)
    sys.stdout.write(f"{text}\n")
    if args.update:
        args.update.write_text(
            replace_section(args.update.read_text(encoding="utf-8"), SECTION, text), encoding="utf-8"
        )
    bad = [each for each in found if not each.good]
    for each in bad:
        sys.stderr.write(f"{each}\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
