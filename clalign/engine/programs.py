"""Kernel sources: where they are, what they declare, and how a program is put together from them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from clalign.errors import DeviceError

PRELUDE = ("prelude.cl",)
PARTS: Mapping[str, tuple[str, ...]] = {
    "product": ("tile.cl", "product.cl"),
    "gram": ("tile.cl", "gram.cl"),
    "nearest": ("tile.cl", "best.cl", "nearest.cl"),
    "soft_map_argmax": ("tile.cl", "best.cl", "soft_map_argmax.cl"),
    "soft_map": ("tile.cl", "panel.cl", "soft_map.cl"),
    "moments": ("tile.cl", "panel.cl", "moments.cl"),
    "soft_map_gradient": ("tile.cl", "soft_map_gradient.cl"),
    "soft_map_streamed": ("tile.cl", "panel.cl", "soft_map_streamed.cl"),
    "cholesky": ("sums.cl", "cholesky.cl"),
    "elementwise": ("sums.cl", "elementwise.cl"),
    "reduce": ("sums.cl", "reduce.cl"),
    "alignment": ("sums.cl", "alignment.cl"),
    "candidates": ("candidates.cl",),
}
"""Program name to the files that follow the prelude in it."""

SIGNATURE = re.compile(r"KERNEL(?:_OF\(\w+\))?\s+void\s+(\w+)\s*\(([^)]*)\)")


@dataclass(frozen=True)
class Source:
    """Text of a program with the options it is built with.

    signatures : function name to the type of each argument: "buffer", "int", "long" or "real".
    """

    name: str
    text: str
    options: tuple[str, ...]
    signatures: Mapping[str, tuple[str, ...]]


@cache
def kernel_folder() -> Path:
    """Return the folder of the ``.cl`` files: inside an installed wheel, or beside the package in a source tree.

    Raises
    ------
    DeviceError
        Neither place has them: the installation is incomplete.
    """
    package = Path(__file__).resolve().parents[1]
    places = (package / "kernels", package.parent / "kernels")
    for place in places:
        if (place / PRELUDE[0]).is_file():
            return place
    looked = " and ".join(str(place) for place in places)
    raise DeviceError(f"the OpenCL kernels are missing (looked in {looked}); reinstall clalign")


def kernel_source(name: str, defines: Mapping[str, str | int]) -> Source:
    """Put a program together.

    The text begins with a hash of itself and of the options: PoCL's cache may otherwise return a program that was
    built with other ``-D`` values.

    Parameters
    ----------
    name : a key of `PARTS`.
    defines : ``-D`` names and values.

    Raises
    ------
    DeviceError
        Unknown program.
    """
    if name not in PARTS:
        raise DeviceError(f"unknown kernel program {name!r}; there are {', '.join(PARTS)}")
    body = "\n".join((kernel_folder() / part).read_text(encoding="utf-8") for part in PRELUDE + PARTS[name])
    options = ("-cl-mad-enable", *(f"-D{key}={value}" for key, value in sorted(defines.items())))
    digest = hashlib.sha256("\0".join((body, *options)).encode()).hexdigest()
    return Source(name, f"/* {digest} */\n{body}", options, _signatures(body))


def _signatures(text: str) -> dict[str, tuple[str, ...]]:
    found = {}
    for function, arguments in SIGNATURE.findall(text):
        found[function] = tuple(_argument_type(argument) for argument in arguments.split(","))
    return found


def _argument_type(declaration: str) -> str:
    if "__global" in declaration:
        return "buffer"
    for kind in ("int", "long", "real"):
        if re.search(rf"\b{kind}\b", declaration):
            return kind
    raise DeviceError(f"kernel argument of unknown type: {declaration.strip()!r}")
