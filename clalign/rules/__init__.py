"""Every number that steers a result and that no user needs to know, with its reason.

Rules are passed down as arguments, written to ``result.json`` with the options, and varied by the study like options:
``--set rules.search.finalists=32``. What is not here guards floating-point arithmetic, or chooses between ways to
compute the same; ``maps/nearest.py`` and ``maps/inverted_file.py`` say from which size on, and how, nearest neighbours
are approximated, ``geometry/heat.py`` from which on distances are marched, and the modules of ``mesh/`` how damaged
files are read.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from clalign.rules.parts import (
    PartRules,
)
from clalign.rules.refinement import (
    AlignmentRules,
    AnchorRules,
    PointwiseKind,
    RefinementRules,
    ZoomOutSchedule,
)
from clalign.rules.results import (
    CollectionRules,
    JudgementRules,
    LandmarkRules,
    RegistrationRules,
    RelationRules,
)
from clalign.rules.search import (
    Level,
    Levels,
    RivalRules,
    SearchRules,
    ShapeRules,
    StartRules,
    TipRules,
    TreeRules,
)

__all__ = [
    "AlignmentRules",
    "AnchorRules",
    "CollectionRules",
    "JudgementRules",
    "LandmarkRules",
    "Level",
    "Levels",
    "PartRules",
    "PointwiseKind",
    "RefinementRules",
    "RegistrationRules",
    "RelationRules",
    "RivalRules",
    "Rules",
    "SearchRules",
    "ShapeRules",
    "StartRules",
    "TipRules",
    "TreeRules",
    "ZoomOutSchedule",
]


@dataclass(frozen=True)
class Rules:
    """All rules; see each group."""

    shape: ShapeRules = field(default_factory=ShapeRules)
    start: StartRules = field(default_factory=StartRules)
    search: SearchRules = field(default_factory=SearchRules)
    rivals: RivalRules = field(default_factory=RivalRules)
    landmarks: LandmarkRules = field(default_factory=LandmarkRules)
    anchors: AnchorRules = field(default_factory=AnchorRules)
    refinement: RefinementRules = field(default_factory=RefinementRules)
    alignment: AlignmentRules = field(default_factory=AlignmentRules)
    judgement: JudgementRules = field(default_factory=JudgementRules)
    collection: CollectionRules = field(default_factory=CollectionRules)
    relations: RelationRules = field(default_factory=RelationRules)
    registration: RegistrationRules = field(default_factory=RegistrationRules)
    parts: PartRules = field(default_factory=PartRules)
