"""Methods as they are written on a command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import datasets
import numpy as np
import pytest

from clalign.benchmark.layouts import animals
from clalign.benchmark.methods import NAMED, AlignMethod, align_method, method_label, named_methods, split_list
from clalign.errors import OptionError, ResultError
from clalign.options import Options
from clalign.presets import PRESETS

OURS = [name for name in NAMED if name != "pyfm"]


@pytest.mark.parametrize("name", OURS)
def test_every_short_name_is_a_method_of_its_own(name: str) -> None:
    method = align_method(name, {"seed": 3})
    assert (method.name, method.options.seed) == (name, 3)
    others = [align_method(other, {"seed": 3}) for other in OURS if other != name]
    assert method.settings not in {other.settings for other in others}
    with pytest.raises(OptionError, match="unknown option"):
        align_method(name, {"seeds": 3})


def test_every_preset_has_its_name_and_every_method_its_label() -> None:
    for preset in PRESETS:
        assert align_method(preset, {}).options == Options.preset(preset)
    assert len({label for _, label in NAMED.values()}) == len(NAMED)


def test_options_of_its_own_and_a_name() -> None:
    mine = align_method("mine=paper-cycle+alignment.weight=1e+2+alignment.cycle=false", {"seed": 4})
    assert mine.name == "mine"
    assert mine.options == Options.preset("paper").replace({"alignment.weight": 100.0, "seed": 4})
    bare = align_method("default+alignment.weight=50", {})
    assert (bare.name, bare.options) == ("default+alignment.weight=50", Options().replace({"alignment.weight": 50}))
    assert align_method("x=fast+truth=isometric", {}) == AlignMethod("x", Options.preset("fast"), "isometric")


def test_what_a_text_says_outweighs_what_holds_for_all() -> None:
    changes = {"alignment.outer_iterations": "7"}
    assert align_method("closed-form", changes).options.alignment.outer_iterations == 0
    assert align_method("default", changes).options.alignment.outer_iterations == 7


def test_a_list_is_split_outside_of_brackets() -> None:
    entries = ["default", "a=fast+alignment.decay=0.5", "b=paper+x.y=(1, 2,)+x.z=[3,4]", "paper"]
    assert split_list(", ".join(entries)) == entries
    assert split_list("(1,),(2,3) , 4") == ["(1,)", "(2,3)", "4"]


def test_labels_in_figures() -> None:
    labels = [method_label(text) for text in ("paper", "a=paper+seed=1", "default+seed=1", "pyFM")]
    assert labels == ["as printed (Eq. 24)", "a", "default+seed=1", "pyFM"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("best", "unknown method 'best'; there are default, fast, "),
        ("a=best+seed=1", "unknown method 'best'"),
        ("default+fast", "unknown method 'default.fast'"),
        ("a=pyfm", "unknown method 'pyfm'"),
        ("default+truth=exact", "truth=exact .* there are isometric, signs"),
        ("default+spectrum.size=3", r"spectrum\.size"),
        ("default+alignment.weight=heavy", r"alignment\.weight must be float"),
    ],
)
def test_what_is_no_method(text: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        named_methods(["default", text], {})


def test_ours_beside_pyfm() -> None:
    ours, fast, pyfm = named_methods(["default", "fast", "pyfm"], {"seed": 3, "spectrum.basis": "80"})
    assert isinstance(ours, AlignMethod)
    assert ours.options == Options().replace({"seed": 3, "spectrum.basis": 80})
    assert len({ours.settings, fast.settings}) == 2
    assert pyfm.name == "pyFM"


@pytest.mark.filterwarnings("ignore::clalign.errors.ClalignWarning")
def test_what_is_taken_from_the_truth(tmp_path: Path) -> None:
    """With the signs of the mirrored truth the paper's start is the mirror image's: C~ is nearer to that truth."""
    mirror = datasets.write_poses(tmp_path / "egg", ["egg1", "egg2"])
    datasets.write_numbers(tmp_path / "egg" / "mirror.txt", mirror)
    pair = animals(tmp_path / "egg")[0].pairs[0].load()
    quick = {
        "alignment.outer_iterations": 0,
        "spectrum.scale_invariant": 24,
        "spectrum.basis": 16,
        "spectrum.refinement": 16,
    }
    plain, signs, isometric = (
        align_method(text, {**quick, "engine.backend": "reference"}).correspondence(pair)
        for text in ("paper", "paper-mirrored", "paper-isometric")
    )
    same, other = (result.source_scale_invariant.functions for result in (plain, signs))
    assert set(np.sign(np.einsum("nd,nd->d", same, other))) == {-1.0, 1.0}
    np.testing.assert_allclose(np.abs(same), np.abs(other))
    assert not np.array_equal(plain.distortion, isometric.distortion)
    with pytest.raises(ResultError, match="paper-mirrored needs the mirror image of the truth"):
        align_method("paper-mirrored", quick).correspondence(replace(pair, mirrored=None))
