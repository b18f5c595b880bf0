"""What kernels are built and launched with, by the class of the device: one table.

The size of a device, its units and memory, comes from `DeviceFacts`; what kind of arithmetic suits it, from here. A
class that wants a kernel of its own gets a field that says so, as `packs_gram` does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from clalign.engine.device_choice import DeviceFacts


@dataclass(frozen=True)
class DeviceClass:
    """Constants of a class of devices. The words (panel, tile, row group) are those of ``kernels/README.md``.

    name : "cpu" or "gpu".
    work_group : work-items of a work-group.
    vector : bytes of a vector; a row of a panel is two of them.
    tile_rows : rows of the register tile of plain products.
    fitted_tile_rows : rows of a tile where they may follow the number of columns, the preferred ones first.
    product_tiles : most row groups, and most panels, of one work-item of a product.
    soft_map_panels : most panels of one work-item of a soft map: they read the right side once.
    soft_map_features : products of two functions that such an item makes at once, in private memory.
    nearest_groups : row groups of one work-item of the nearest points, and their number where rows are very many.
    packs_gram : whether work-items of a Gram matrix pack what they read (``gram.cl``), each into a cache of its own.
    """

    name: str
    work_group: int
    vector: int
    tile_rows: int
    fitted_tile_rows: tuple[int, ...]
    product_tiles: int
    soft_map_panels: int
    soft_map_features: int
    nearest_groups: tuple[int, int]
    packs_gram: bool


CPU = DeviceClass(
    name="cpu",
    # PoCL runs a work-group in one thread, one item after the other: a single one may own as much.
    work_group=1,
    vector=32,
    # 6 x 2 accumulators, two vectors of the panel and a scalar: the 16 registers of AVX2.
    tile_rows=6,
    fitted_tile_rows=(6, 5),
    product_tiles=16,
    soft_map_panels=4,
    soft_map_features=256,
    nearest_groups=(8, 32),
    packs_gram=True,
)
CPU_LONG_VECTORS = replace(CPU, vector=64, tile_rows=8, fitted_tile_rows=(10, 9, 8, 7))
"""AVX-512 has twice as many registers."""

GPU = DeviceClass(
    name="gpu",
    work_group=64,
    vector=32,
    tile_rows=6,
    fitted_tile_rows=(6, 5),
    # Many small items keep a GPU busy, and their private memory is scarce.
    product_tiles=1,
    soft_map_panels=1,
    soft_map_features=8,
    nearest_groups=(1, 1),
    packs_gram=False,
)


def device_class(facts: DeviceFacts) -> DeviceClass:
    """Return the class of a device; accelerators are treated as GPUs."""
    if facts.kind != "cpu":
        return GPU
    return CPU_LONG_VECTORS if facts.vector >= CPU_LONG_VECTORS.vector else CPU
