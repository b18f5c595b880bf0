"""Options refuse what makes no sense, and survive being written down."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import operator
import warnings
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clalign.errors import ClalignWarning, OptionError
from clalign.geometry.cache import ShapeCache, given_cache
from clalign.matching.pair import match
from clalign.option_values import leaves
from clalign.options import Options, given_options, odd_sizes
from clalign.presets import PRESETS

KINDS = {name: kind for name, kind in leaves(Options()) if name != "seed"}
NAMES = sorted(KINDS.keys() - {"rules.refinement.schedules", "rules.parts.growth.starts"})
NUMBERS = [name for name in NAMES if KINDS[name] in (int, float)]


def read(options: Options, name: str) -> Any:
    return operator.attrgetter(name)(options)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_survive_json(name: str) -> None:
    options = Options.preset(name)
    assert Options.from_dict(json.loads(json.dumps(options.as_dict()))) == options


def test_presets_differ_and_default_is_the_default() -> None:
    assert Options.preset("default") == Options()
    assert len({Options.preset(name) for name in PRESETS}) == len(PRESETS)


def test_paper_preset_is_the_method_as_printed() -> None:
    paper = Options.preset("paper")
    assert paper.spectrum.basis == 120
    assert paper.spectrum.scale_invariant == 352
    assert paper.alignment.weight == 200
    assert (paper.alignment.band_slope, paper.alignment.band_offset) == (2.5, 2)
    assert paper.search.method == "random"
    assert paper.readout.readout == "argmax"


@pytest.mark.parametrize("name", NAMES)
def test_every_value_can_be_given_as_text(name: str) -> None:
    current = read(Options(), name)
    assert Options().replace({name: str(current)}) == Options()


@pytest.mark.parametrize("name", [name for name in NAMES if KINDS[name] in (int, float, bool)])
def test_every_number_refuses_words(name: str) -> None:
    with pytest.raises(OptionError, match=name):
        Options().replace({name: "many"})


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "1" + 400 * "0"], ids=["negative", "nan", "inf", "huge"])
def test_every_number_refuses_negative_and_infinite_values(name: str, value: str) -> None:
    # An orientation is at least -1.
    refused = "-2" if value == "-1" and name.endswith("orientation") else value
    with pytest.raises(OptionError, match=name):
        Options().replace({name: refused})


@pytest.mark.parametrize("name", NAMES)
def test_every_choice_lists_what_there_is(name: str) -> None:
    hint = KINDS[name]
    if get_origin(hint) is not Literal:
        return
    for word in get_args(hint):
        assert read(Options().replace({name: word}), name) == word
    with pytest.raises(OptionError, match=str(get_args(hint)[0])):
        Options().replace({name: "something-else"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spectrum.basiss": 3}, "unknown option 'spectrum.basiss'; did you mean"),
        ({"spectra.basis": 3}, "unknown option group 'spectra'"),
        ({"spectrum": 3}, "unknown option 'spectrum'"),
        ({"sed": 3}, "unknown option 'sed'"),
        ({"alignment.cycle": "maybe"}, "true or false"),
        ({"alignment.cycle": 1}, "true or false"),
        ({"spectrum.basis": 3.5}, "whole number"),
        ({"spectrum.basis": "3.5"}, "must be int"),
        ({"spectrum.basis": 0}, "positive"),
        ({"spectrum.basis": float("inf")}, "must be int"),
        ({"seed": float("nan")}, "must be int"),
        ({"seed": "-1"}, "seed must not be negative"),
        ({"spectrum.xi": 1.5}, r"\(0, 1\]"),
        ({"spectrum.smoothing": -1e-3}, "must not be negative"),
        ({"spectrum.noisy_below": 1.5}, r"\[0, 1\]"),
        ({"spectrum.clamp": 0.5}, r"\[0, 0.5\)"),
        ({"spectrum.__class__": 3}, "unknown option"),
        ({"seed.x": 3}, "unknown option group 'seed'"),
    ],
)
def test_messages_say_what_is_wrong(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Options().replace(changes)


@pytest.mark.parametrize("count", [1, 2])
def test_a_search_needs_three_functions(count: int) -> None:
    few = {"spectrum.basis": count, "spectrum.refinement": count}
    with pytest.raises(OptionError, match=rf"at least 3 for a search, got {count}: the orientation"):
        Options().replace(few)
    assert Options().replace({**few, "search.method": "random"}).spectrum.basis == count
    for name in few:
        assert Options().replace({**few, name: 3}).search.method == "tree"


def test_unknown_preset_lists_the_presets() -> None:
    with pytest.raises(OptionError, match="default, fast, paper"):
        Options.preset("quick")


def test_from_dict_refuses_unknown_names() -> None:
    with pytest.raises(OptionError, match="spectrum"):
        Options.from_dict({"spectrum": {"colour": 1}})


CHANGES = st.one_of(st.text(max_size=10), st.floats(), st.integers(), st.none())


@given(name=st.text(max_size=20), value=CHANGES)
def test_nothing_but_option_errors_leave_replace(name: str, value: Any) -> None:
    for key in (name, f"spectrum.{name}", "spectrum.basis", "alignment.cycle", "spectrum.metric", "seed"):
        with contextlib.suppress(OptionError), warnings.catch_warnings():
            # Some drawn names are those of the release before.
            warnings.simplefilter("ignore", ClalignWarning)
            changed = Options().replace({key: value})
            assert Options.from_dict(changed.as_dict()) == changed


def test_options_are_frozen_and_leave_the_original_alone() -> None:
    options = Options()
    changed = options.replace({"alignment.weight": 5, "seed": "3"})
    assert (changed.alignment.weight, changed.seed) == (5.0, 3)
    assert options == Options()
    with pytest.raises(dataclasses.FrozenInstanceError):
        changed.seed = 4  # type: ignore[misc]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ({"alignment.rounds": "2"}, {"alignment.outer_iterations": 2}),
        ({"alignment.denominator": "frozen"}, {"alignment.denominator": "fixed"}),
        ({"readout.refine": "pieces"}, {}),
        ({"readout.refine": "upsample"}, {"readout.refine": "zoomout"}),
        ({"spectrum.descriptors": 40}, {"spectrum.scale_invariant": 40}),
        ({"alignment.distances": "factors"}, {}),
        ({"spectrum.solver": "block"}, {}),
    ],
)
def test_names_of_the_release_before_are_translated(old: dict[str, Any], new: dict[str, Any]) -> None:
    with pytest.warns(ClalignWarning, match=rf"option {next(iter(old))}.*one release"):
        changed = Options().replace(old)
    assert changed == Options().replace(new)
    nested: dict[str, dict[str, Any]] = {}
    for key, value in old.items():
        group, name = key.split(".")
        nested[group] = {name: value}
    # What was written down then is read without a word.
    assert Options.from_dict(nested) == changed


@pytest.mark.parametrize("key", ["alignment.distances", "spectrum.solver"])
def test_what_nothing_does_any_more_is_refused(key: str) -> None:
    with pytest.raises(OptionError, match=rf"{key}=dense: this option was removed"):
        Options().replace({key: "dense"})


def test_rules_can_be_changed_down_to_schedules() -> None:
    changed = Options().replace(
        {
            "rules.search.oriented.strengths": "0.5",
            "rules.search.fine.sizes": [45, 60],
            "rules.refinement.schedules": '[{"start": null, "step": 10}, {"start": 25, "descriptors": "oriented"}]',
        }
    )
    assert changed.rules.search.oriented.strengths == (0.5,)
    assert changed.rules.search.fine.sizes == (45, 60)
    assert [each.start for each in changed.rules.refinement.schedules] == [None, 25]
    assert Options.from_dict(json.loads(json.dumps(changed.as_dict()))) == changed


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rules.search.fine.sizes": "many"}, "values with commas"),
        ({"rules.search.fine.sizes": 3}, "list of values"),
        ({"rules.refinement.schedules": [{"colour": 1}]}, "must hold values of start, step"),
        ({"rules.search.finalists": -1}, "rules.search.finalists must be at least 0"),
        ({"rules.search.wide_radius": "nan"}, "rules.search.wide_radius"),
        ({"rules.alignment.exponents": ""}, "rules.alignment.exponents must not be empty"),
        ({"rules.refinement.schedules": [{"step": 0}]}, "schedules.step must be at least 1"),
        ({"rules.refinement.schedules": [{"descriptors": "colour"}]}, "schedules.descriptors must be one of"),
    ],
)
def test_messages_of_rules(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Options().replace(changes)


@pytest.mark.parametrize(
    ("thing", "message"),
    [
        ("fast", r"options must be an Options, not str; pass Options.preset\('fast'\)"),
        ("quick", r"not str; pass Options.preset\('fast'\)"),
        ({"seed": 1}, r"not dict; pass Options\(\).replace\(\{'seed': 1\}\)"),
        (5, r"not int; pass Options\(\).replace"),
    ],
)
def test_what_is_given_in_place_of_options_is_told_how_to_be_given(thing: object, message: str) -> None:
    faces = [[0, 1, 2]]
    with pytest.raises(OptionError, match=message):
        given_options(thing)
    with pytest.raises(OptionError, match=message):
        match((faces, faces), (faces, faces), thing)  # type: ignore[arg-type]


def test_a_cache_is_an_object_and_no_folder(tmp_path: Path) -> None:
    for thing, message in (
        ("no-such-folder", r"cache must be a ShapeCache, not str; pass ShapeCache\('no-such-folder'\) from"),
        (tmp_path, r"; pass ShapeCache\('/?.*'\) from clalign.geometry.cache"),
        (True, r"not bool; pass ShapeCache\(\) from"),
    ):
        with pytest.raises(OptionError, match=message):
            match("a.off", "b.off", cache=thing)  # type: ignore[arg-type]
    assert given_cache(None) is None
    assert given_cache(kept := ShapeCache(tmp_path)) is kept


def test_sizes_that_cannot_be_had_are_said() -> None:
    assert odd_sizes(Options(), 1000) == []
    assert odd_sizes(Options.preset("paper"), 120) == []
    small = Options().replace({"spectrum.refinement": 3})
    assert odd_sizes(small, 1000) == [
        "spectrum.refinement=3 is less than spectrum.basis=120; 120 eigenfunctions are computed"
    ]
    (large,) = odd_sizes(Options().replace({"spectrum.basis": 5000, "spectrum.refinement": 5000}), 1229)
    assert large.startswith("spectrum.basis=5000 is more than the 1229 vertices of the smaller mesh")
