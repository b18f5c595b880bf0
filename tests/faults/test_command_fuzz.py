"""Random options and damaged meshes through whole commands: a result, or one line that is no stack trace."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import tempfile
import warnings
from pathlib import Path

import malformed
import shapes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from quick import QUICK

from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.options import Options

# More examples, new ones on every run: CLALIGN_FUZZ_EXAMPLES=1000 pytest tests/faults/test_command_fuzz.py
EXAMPLES = os.environ.get("CLALIGN_FUZZ_EXAMPLES")
BOUNDED = settings(
    max_examples=int(EXAMPLES or 40),
    derandomize=EXAMPLES is None,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
CONTENT = {name.split()[-1]: write(shapes.bumpy_sphere(1)) for name, write in malformed.WRITERS.items()}
GROUPS = {field.name: getattr(Options(), field.name) for field in dataclasses.fields(Options) if field.name != "seed"}
NAMES = [f"{group}.{field.name}" for group, value in GROUPS.items() for field in dataclasses.fields(value)]
#: What a number is made from: the edges of ranges, and what is no number at all.
VALUES = st.sampled_from(
    ["0", "1", "2", "3", "7", "0.5", "1e-9", "-1", "nan", "inf", "1e300", "", "many", "true", "none", "1_0", "½"]
)
#: Words that options of every kind accept.
WORDS = st.sampled_from(
    [
        "any",
        "reversing",
        "full",
        "diagonal",
        "one",
        "differentiated",
        "uniform",
        "argmax",
        "zoomout",
        "random",
        "fixed",
        "regularized",
        "euclidean",
        "heat-kernel",
        "auto",
        "double",
        "single",
    ]
)


def outcome(folder: Path, arguments: list[str]) -> tuple[int, str]:
    """Exit status and standard error of a command that writes to `folder`/out."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        try:
            status = main([*arguments, "--out", str(folder / "out")])
        except SystemExit as stop:
            status = int(str(stop.code))
    return status, errors.getvalue()


def assert_whole_or_nothing(folder: Path, status: int, errors: str) -> None:
    assert "Traceback" not in errors
    assert "not foreseen" not in errors
    if status == 0:
        result = Correspondence.load(folder / "out")
        assert (result.target_of_source[result.source.file_index] >= 0).all()
        return
    assert status in (1, 2)
    assert "error: " in errors
    assert not (folder / "out").exists()
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


@given(changes=st.lists(st.tuples(st.sampled_from(NAMES), VALUES | WORDS), min_size=1, max_size=3))
@BOUNDED
def test_random_options(changes: list[tuple[str, str]]) -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = shapes.write_off(folder / "source.off", vertices, faces)
        target = shapes.write_off(folder / "target.off", shapes.bent(vertices, 0.3), faces)
        arguments = ["match", str(source), str(target), *QUICK, "--no-cache", "--device", "reference"]
        for option, value in changes:
            # The search takes seconds, and the device is not what is tried here.
            if option not in ("search.method", "engine.backend", "engine.memory"):
                arguments += ["--set", f"{option}={value}"]
        assert_whole_or_nothing(folder, *outcome(folder, arguments))


@given(data=st.data())
@BOUNDED
def test_damaged_meshes(data: st.DataObject) -> None:
    suffix = data.draw(st.sampled_from(sorted(CONTENT)))
    content = bytearray(CONTENT[suffix])
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, min(400, len(content))) | st.integers(0, len(content)))
        length = data.draw(st.integers(0, 12))
        content[place : place + length] = data.draw(st.binary(max_size=12))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / f"damaged.{suffix}"
        path.write_bytes(content)
        arguments = ["match", str(path), str(path), *QUICK, "--no-cache", "--device", "reference"]
        status, errors = outcome(folder, arguments)
        assert_whole_or_nothing(folder, status, errors)
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(["check", str(path)]) == (2 if f"{path}: " in errors else 0)
