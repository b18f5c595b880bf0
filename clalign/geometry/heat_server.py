"""The far side of `heat_process`: sampling surfaces that come in on standard input until it is closed.

A message is a byte that says what it is, the length of the rest, and the rest: an ``.npz`` file, or text.
"""

from __future__ import annotations

import io
import os
import struct
import sys
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError
from clalign.geometry.heat import Surface, farthest_points

REQUEST, ANSWER, REFUSED = b"?", b"=", b"!"
_HEAD = struct.Struct("<cQ")


def send(stream: IO[bytes], kind: bytes, body: bytes | memoryview) -> None:
    """Write one message."""
    stream.write(_HEAD.pack(kind, len(body)))
    stream.write(body)
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[bytes, bytes] | None:
    """Return kind and body of the next message, or None where the stream ends, be it in the middle of one."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, length = _HEAD.unpack(head)
    body = stream.read(length)
    return (kind, body) if len(body) == length else None


def packed(arrays: Mapping[str, NDArray[Any]]) -> memoryview:
    """Return arrays as the contents of an ``.npz`` file, without one more copy of them."""
    stream = io.BytesIO()
    contents: dict[str, Any] = dict(arrays)
    np.savez(stream, **contents)
    return stream.getbuffer()


def unpacked(body: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of `packed`."""
    with np.load(io.BytesIO(body), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def answer(body: bytes) -> tuple[bytes, bytes | memoryview]:
    """Return kind and body of the answer to one request."""
    values = unpacked(body)
    central, count, kept = (int(number) for number in values["numbers"])
    surface = Surface(values["vertices"], values["faces"], values["mass"], str(values["name"]))
    try:
        return ANSWER, packed(vars(farthest_points(surface, central, count, kept)))
    except MeshError as error:
        return REFUSED, str(error).encode()


def main() -> None:
    """Answer requests until there are no more."""
    # Native code prints to the standard output; only what is sent may go where the answers go.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    while (message := receive(sys.stdin.buffer)) is not None:
        send(answers, *answer(message[1]))
