from __future__ import annotations

import importlib.metadata

import pytest
import shapes

from clalign.benchmark.pairs import LoadedPair
from clalign.benchmark.peers import PyfmMethod
from clalign.benchmark.perturb import renumber
from clalign.errors import InputError
from clalign.evaluation.errors import evaluate
from clalign.mesh.mesh import mesh_from_arrays


@pytest.mark.filterwarnings("ignore")
def test_pyfm_maps_from_source_to_target() -> None:
    """A shuffled copy of a shape without symmetry: a map in the wrong direction would be a random one."""
    source = mesh_from_arrays(*shapes.bumpy_sphere(3), name="bumpy")
    moved = renumber(source, seed=1)
    outcome = PyfmMethod(refined=60)(LoadedPair("bumpy", source, moved.mesh, moved.truth, None))
    result = evaluate(outcome.target_of_source, moved.truth, source=source, target=moved.mesh)
    assert result.mean < 0.05
    assert set(outcome.stages) == {"spectra", "fit", "zoomout"}
    assert sum(outcome.stages.values()) == pytest.approx(outcome.seconds)


def test_settings_tell_values_apart() -> None:
    assert PyfmMethod().settings != PyfmMethod(orientation=0.2).settings
    assert PyfmMethod().settings == PyfmMethod().settings


def test_without_pyfm_the_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr("clalign.benchmark.peers.version", absent)
    with pytest.raises(InputError, match=r"pip install pyfmaps==1\.3\.1"):
        _ = PyfmMethod().settings
