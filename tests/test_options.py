"""Options refuse what makes no sense, and survive being written down."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clalign.errors import OptionError
from clalign.options import PRESETS, Options

NAMES = sorted(
    f"{group.name}.{value.name}"
    for group in dataclasses.fields(Options)
    if group.name != "seed"
    for value in dataclasses.fields(getattr(Options(), group.name))
)


def read(options: Options, name: str) -> Any:
    group, value = name.split(".")
    return getattr(getattr(options, group), value)


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
    assert paper.spectrum.descriptors == 352
    assert paper.alignment.weight == 200
    assert (paper.alignment.band_slope, paper.alignment.band_offset) == (2.5, 2)
    assert paper.search.method == "random"
    assert paper.readout.readout == "argmax"


@pytest.mark.parametrize("name", NAMES)
def test_every_value_can_be_given_as_text(name: str) -> None:
    current = read(Options(), name)
    assert Options().replace({name: str(current)}) == Options()


@pytest.mark.parametrize("name", [name for name in NAMES if isinstance(read(Options(), name), int | float)])
def test_every_number_refuses_words(name: str) -> None:
    with pytest.raises(OptionError, match=name):
        Options().replace({name: "many"})


@pytest.mark.parametrize(
    "name",
    [n for n in NAMES if isinstance(read(Options(), n), int | float) and not isinstance(read(Options(), n), bool)],
)
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "1" + 400 * "0"], ids=["negative", "nan", "inf", "huge"])
def test_every_number_refuses_negative_and_infinite_values(name: str, value: str) -> None:
    with pytest.raises(OptionError, match=name):
        Options().replace({name: value})


@pytest.mark.parametrize("name", NAMES)
def test_every_choice_lists_what_there_is(name: str) -> None:
    group, value = name.split(".")
    hint = get_type_hints(type(getattr(Options(), group)))[value]
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


@pytest.mark.parametrize("method", ["tree", "signs"])
@pytest.mark.parametrize("count", [1, 2])
def test_a_search_needs_three_functions(method: str, count: int) -> None:
    few = {"spectrum.basis": count, "spectrum.refinement": count}
    with pytest.raises(OptionError, match=rf"at least 3 for a search, got {count}: the orientation"):
        Options().replace({**few, "search.method": method})
    assert Options().replace({**few, "search.method": "random"}).spectrum.basis == count
    for name in few:
        assert Options().replace({**few, name: 3, "search.method": method}).search.method == method


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
        with contextlib.suppress(OptionError):
            changed = Options().replace({key: value})
            assert Options.from_dict(changed.as_dict()) == changed


def test_options_are_frozen_and_leave_the_original_alone() -> None:
    options = Options()
    changed = options.replace({"alignment.weight": 5, "seed": "3"})
    assert (changed.alignment.weight, changed.seed) == (5.0, 3)
    assert options == Options()
    with pytest.raises(dataclasses.FrozenInstanceError):
        changed.seed = 4  # type: ignore[misc]
