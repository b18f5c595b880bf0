"""What a result says of a match between a part and a whole."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from clalign.partial.extent import Side


@dataclass(frozen=True)
class Partiality:
    """Which mesh is a part of the other.

    Attributes
    ----------
    side : the part.
    scale : lengths on the whole over those on the part, both in the unit of its file; 1 where they have the same.
    area : of the part, as a share of the whole's.
    asked : whether a user said so; otherwise it was found.
    """

    side: Side
    scale: float
    area: float
    asked: bool

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, as written to ``result.json``."""
        return asdict(self)

    def sentence(self, source: str, target: str) -> str:
        """Return what is to be said of it, with the names of both meshes."""
        part, whole = (source, target) if self.side == "source" else (target, source)
        said = f"{part} was matched as a part of {whole}, with {self.area:.0%} of its area"
        if abs(self.scale - 1.0) > 0.005:
            said += f" at {self.scale:.3g} times the scale of its file"
        return said if self.asked else f"{said}; --partial none takes both as wholes"
