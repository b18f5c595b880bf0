"""Kernel sources: where they are, what they declare, and how a program is put together from them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from clalign.errors import DeviceError

PRELUDE = "prelude.cl"
"""The file that comes before every program."""

INCLUDE = re.compile(r'^#include "(\w+\.cl)"$', re.MULTILINE)
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
        if (place / PRELUDE).is_file():
            return place
    looked = " and ".join(str(place) for place in places)
    raise DeviceError(f"the OpenCL kernels are missing (looked in {looked}); reinstall clalign")


@cache
def program_names() -> tuple[str, ...]:
    """Return the programs: the files that have kernels, without ``.cl``; the others are included by them."""
    return tuple(sorted(file.stem for file in kernel_folder().glob("*.cl") if SIGNATURE.search(_text(file.name))))


def kernel_source(name: str, defines: Mapping[str, str | int], options: Sequence[str] = ()) -> Source:
    """Put a program together: the prelude, and its file with what that includes.

    The text begins with a hash of itself and of the options: PoCL's cache may otherwise return a program that was
    built with other ``-D`` values.

    defines : ``-D`` names and values.
    options : of the compiler, beside those of every program.

    Raises
    ------
    DeviceError
        `name` is not one of `program_names`.
    """
    if name not in program_names():
        raise DeviceError(f"unknown kernel program {name!r}; there are {', '.join(program_names())}")
    body = f"{_text(PRELUDE)}\n{_expanded(name + '.cl')}"
    every = ("-cl-mad-enable", *options, *(f"-D{key}={value}" for key, value in sorted(defines.items())))
    digest = hashlib.sha256("\0".join((body, *every)).encode()).hexdigest()
    return Source(name, f"/* {digest} */\n{body}", every, _signatures(body))


def _text(file: str) -> str:
    return (kernel_folder() / file).read_text(encoding="utf-8")


def _expanded(file: str) -> str:
    """Return the text of a file with what it includes in place of the directives."""
    return INCLUDE.sub(lambda found: _expanded(found[1]), _text(file))


def _signatures(text: str) -> dict[str, tuple[str, ...]]:
    return {
        function: tuple(map(_argument_type, arguments.split(","))) for function, arguments in SIGNATURE.findall(text)
    }


def _argument_type(declaration: str) -> str:
    if "__global" in declaration:
        return "buffer"
    for kind in ("int", "long", "real"):
        if re.search(rf"\b{kind}\b", declaration):
            return kind
    raise DeviceError(f"kernel argument of unknown type: {declaration.strip()!r}")
