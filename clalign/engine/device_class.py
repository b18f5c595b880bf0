"""What kernels are built and launched with, by the class of the device: one table.

The size of a device, its units and memory, comes from `DeviceFacts`; what kind of arithmetic suits it, from here. The
two classes have kernels of their own where their loops differ (files ``gpu_*.cl``), which `cpu` and `gpu` launch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

from clalign.engine.device_choice import DeviceFacts

ClassName: TypeAlias = Literal["auto", "cpu", "gpu"]
"""Name of a class; "auto" leaves it to the facts of the device."""


@dataclass(frozen=True)
class CpuClass:
    """Constants of CPUs. The words (panel, tile, row group) are those of ``kernels/README.md``.

    vector : bytes of a vector; a row of a panel is two of them.
    tile_rows : rows of the register tile of plain products.
    fitted_tile_rows : rows of a tile where they may follow the number of columns, the preferred ones first.
    product_tiles : most row groups, and most panels, of one work-item of a product.
    soft_map_panels : most panels of one work-item of a soft map: they read the right side once.
    soft_map_features : products of two functions that such an item makes at once, in private memory.
    nearest_groups : row groups of one work-item of the nearest points, and their number where rows are very many.
    work_group : work-items of a work-group.
    options : of the compiler, beside those of all programs.
    """

    vector: int
    tile_rows: int
    fitted_tile_rows: tuple[int, ...]
    product_tiles: int = 16
    soft_map_panels: int = 4
    soft_map_features: int = 256
    nearest_groups: tuple[int, int] = (8, 32)
    # PoCL runs a work-group in one thread, one item after the other: a single one may own as much.
    work_group: int = 1
    options: tuple[str, ...] = ()
    name: str = "cpu"

    def definitions(self, item_bytes: int) -> dict[str, int]:
        """``-D`` names and values of every program, for reals of that many bytes."""
        return {"ON_CPU": 1, "WG": self.work_group, "V": self.vector // item_bytes}


class Tile(NamedTuple):
    """The tile of a work-group: rows, columns, and the depth of its panels in local memory (``gpu_tile.cl``)."""

    rows: int
    columns: int
    depth: int

    @property
    def definitions(self) -> dict[str, int]:
        """``-D`` names and values."""
        return {"TM": self.rows, "TN": self.columns, "KT": self.depth}


@dataclass(frozen=True)
class GpuClass:
    """Constants of GPUs.

    large, small : tiles of products: the large one where it keeps the device busy.
    soft_map, gradient, best, streamed, core : tiles of the kernels of these names.
    unroll : steps of a panel that are multiplied in a row.
    streamed_unroll : the same where two chained tiles leave fewer registers.
    groups_per_unit : work-groups that a unit should have; a sum is split where the tiles of its result are fewer.
    split_depth : least depth of a split.
    work_group : work-items of a work-group.
    options : of the compiler, beside those of all programs.
    """

    large: Tile
    small: Tile
    soft_map: Tile
    gradient: Tile
    best: Tile
    streamed: Tile
    core: Tile
    unroll: int = 4
    streamed_unroll: int = 2
    groups_per_unit: int = 2
    split_depth: int = 256
    work_group: int = 256
    options: tuple[str, ...] = ()
    name: str = "gpu"

    def definitions(self, item_bytes: int) -> dict[str, int]:
        """``-D`` names and values of every program."""
        return {"ON_CPU": 0, "WG": self.work_group}


DeviceClass: TypeAlias = CpuClass | GpuClass

# 6 x 2 accumulators, two vectors of the panel and a scalar: the 16 registers of AVX2.
CPU = CpuClass(vector=32, tile_rows=6, fitted_tile_rows=(6, 5))
CPU_LONG_VECTORS = replace(CPU, vector=64, tile_rows=8, fitted_tile_rows=(10, 9, 8, 7))
"""AVX-512 has twice as many registers."""

# 8 x 4 sums an item: a step reads 12 numbers from local memory for 32 multiply-adds, and two work-groups share the
# registers of a unit. 8 x 8 would need more registers than that allows.
_WIDE, _SQUARE = Tile(128, 64, 8), Tile(64, 64, 16)
GPU = GpuClass(
    large=_WIDE, small=_SQUARE, soft_map=_WIDE, gradient=_WIDE, best=_WIDE, streamed=Tile(64, 64, 8), core=_SQUARE
)
_DOUBLES = Tile(64, 64, 4)
GPU_DOUBLE = GpuClass(
    large=_DOUBLES,
    small=_DOUBLES,
    soft_map=_DOUBLES,
    gradient=_DOUBLES,
    best=_DOUBLES,
    streamed=_DOUBLES,
    core=_DOUBLES,
    unroll=2,
)
"""Doubles fill twice the registers and local memory."""

GPU_LOCAL_MEMORY = 32 * 1024
"""Bytes of local memory that the kernels of the class of GPUs may use."""


def class_name(facts: DeviceFacts) -> Literal["cpu", "gpu"]:
    """Return the class that suits a device: "gpu" where neighbours run together and share memory of their own.

    An accelerator is a GPU if its local memory is no part of the global one; a device whose work-groups or local memory
    are too small for the kernels of GPUs gets those of CPUs, which need neither.
    """
    large_enough = facts.largest_group >= GPU.work_group and facts.local_memory >= GPU_LOCAL_MEMORY
    shaped = facts.kind == "gpu" or (facts.kind != "cpu" and facts.own_local_memory)
    return "gpu" if shaped and large_enough else "cpu"


def device_class(facts: DeviceFacts, item_bytes: int = 4, name: ClassName = "auto") -> DeviceClass:
    """Return the constants for a device and reals of that many bytes; "auto" takes the class that suits the device."""
    if (class_name(facts) if name == "auto" else name) == "cpu":
        return CPU_LONG_VECTORS if facts.vector >= CPU_LONG_VECTORS.vector else CPU
    constants = GPU_DOUBLE if item_bytes == 8 else GPU
    # Only to check them: compilers for CPUs take minutes over loop bodies written for hundreds of registers.
    return replace(constants, options=("-cl-opt-disable",)) if facts.kind == "cpu" else constants
