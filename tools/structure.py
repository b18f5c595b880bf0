"""Count what a reader has to hold in mind: lines, modules, options, and how deep one match goes.

``PYTHONPATH=CHECKOUT python tools/structure.py CHECKOUT`` counts a checkout, whichever release it is of. The call chain
is measured: a small pair is matched twice, and the second match is watched for the frames of the package that are on
the stack at a time (of comprehensions only what they call). Work in other threads counts, in other processes not.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

LONG_MODULE = 400
LONG_FUNCTION = 60
VERTICES = 400
COMPREHENSIONS = {"<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>"}


class Stack:
    """Watches which frames of a package are on the stack of each thread.

    folder : of the package.
    deepest : names of the functions on the stack when it was deepest.
    files : every file of the package in which a function was called.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)
        self.deepest: list[str] = []
        self.files: set[str] = set()
        self._threads = threading.local()

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Follow one event of `sys.setprofile`."""
        code = frame.f_code
        if (
            event not in ("call", "return")
            or code.co_name in COMPREHENSIONS
            or not code.co_filename.startswith(self.folder)
        ):
            return
        stack: list[str] = self._threads.__dict__.setdefault("stack", [])
        if event == "return":
            if stack:
                stack.pop()
            return
        place = Path(code.co_filename).relative_to(self.folder).with_suffix("")
        stack.append(f"{'.'.join(place.parts)}.{code.co_qualname}")
        self.files.add(code.co_filename)
        if len(stack) > len(self.deepest):
            self.deepest = list(stack)


def bumpy(seed: int) -> tuple[Any, Any]:
    """Return vertices and faces of a closed body without symmetry, in a vertex order and mesh of its own."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(VERTICES)
    height, angle = 1.0 - (2.0 * order + 1.0) / VERTICES, order * np.pi * (3.0 - 5.0**0.5)
    across = np.sqrt(1.0 - height**2)
    points = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    faces = ConvexHull(points).simplices
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward, ::-1]
    centres = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6], [-0.6, 0.0, 0.8], [0.0, -0.6, -0.8]])
    bumps = np.exp(6.0 * (points @ centres.T - 1.0)) @ np.array([0.5, 0.3, 0.6, 0.2])
    return points * [1.0, 0.7, 0.55] * (1.0 + bumps)[:, None], faces


def watched_match(folder: Path) -> Stack:
    """Return what was on the stack during a match with default options."""
    import clalign

    warnings.simplefilter("ignore")
    pair = bumpy(1), bumpy(2)
    # The first match imports modules.
    clalign.match(*pair)
    stack = Stack(folder)
    threading.setprofile(stack)
    sys.setprofile(stack)
    try:
        clalign.match(*pair)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return stack


def option_names(values: Any, prefix: str = "") -> Iterator[str]:
    """Yield the dotted names of all plain values of nested dataclasses."""
    for entry in dataclasses.fields(values):
        value = getattr(values, entry.name)
        if dataclasses.is_dataclass(value):
            yield from option_names(value, f"{prefix}{entry.name}.")
        else:
            yield f"{prefix}{entry.name}"


def long_functions(source: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines and the name of every function of a module that is too long."""
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None:
            lines = node.end_lineno - node.lineno + 1
            if lines > LONG_FUNCTION:
                yield lines, f"{source.name}:{node.lineno} {node.name}"


def report(checkout: Path) -> Iterator[str]:
    """Yield the lines of the report on a checkout whose package is the one that is imported."""
    import clalign
    from clalign.options import Options

    folder = checkout / "clalign"
    if Path(clalign.__file__).resolve().parent != folder:
        raise SystemExit(f"clalign comes from {clalign.__file__}: run with PYTHONPATH={checkout}")
    modules = {path: path.read_text(encoding="utf-8").count("\n") for path in sorted(folder.rglob("*.py"))}
    kernels = {path: path.read_text(encoding="utf-8").count("\n") for path in (checkout / "kernels").glob("*.cl")}
    yield f"lines: {sum(modules.values()):,} of clalign and {sum(kernels.values()):,} of kernels"
    yield f"modules: {len(modules)}, kernel files: {len(kernels)}"
    rooms: dict[str, tuple[int, int]] = {}
    for path, lines in modules.items():
        room = path.relative_to(folder).parts[0].removesuffix(".py")
        count, total = rooms.get(room, (0, 0))
        rooms[room] = (count + 1, total + lines)
    yield "rooms, modules and lines: " + ", ".join(f"{room} {count} {total}" for room, (count, total) in rooms.items())
    names = list(option_names(Options()))
    rules = [name for name in names if name.startswith("rules.")]
    yield f"options: {len(names) - len(rules)}, rules: {len(rules)}"
    long = [f"{path.relative_to(folder)} {lines}" for path, lines in modules.items() if lines > LONG_MODULE]
    yield f"modules over {LONG_MODULE} lines: {len(long)} {', '.join(long)}".rstrip()
    functions = sorted((found for path in modules for found in long_functions(path)), reverse=True)
    listed = ", ".join(f"{name} {lines}" for lines, name in functions)
    yield f"functions over {LONG_FUNCTION} lines: {len(functions)} {listed}".rstrip()
    stack = watched_match(folder)
    yield f"a match of {VERTICES} vertices: {len(stack.deepest)} frames deep, functions of {len(stack.files)} files"
    yield from (f"  {number:2} {name}" for number, name in enumerate(stack.deepest, start=1))


def main() -> None:
    """Print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", metavar="CHECKOUT", type=Path, help="folder with clalign and kernels")
    for line in report(parser.parse_args().checkout.resolve()):
        sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
