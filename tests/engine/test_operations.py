"""An operation is described once: the kernels follow the signatures and the docstrings of their numpy twins."""

from __future__ import annotations

import inspect

import pytest

from clalign.engine.kernels import Kernels
from clalign.engine.kernels_arrays import operation
from clalign.engine.reference import Reference


def public(owner: type) -> set[str]:
    return {name for name in dir(owner) if not name.startswith("_")}


def plain(owner: type, name: str) -> object:
    member = inspect.getattr_static(owner, name)
    return member.fget if isinstance(member, property) else member


def test_kernels_and_reference_offer_the_same_operations():
    assert public(Kernels) == public(Reference)
    assert not issubclass(Kernels, Reference), "an operation without a kernel must fail, not run in numpy"


@pytest.mark.parametrize("name", sorted(public(Reference)))
def test_signatures_and_docstrings_are_those_of_the_twin(name: str):
    kernel, twin = plain(Kernels, name), plain(Reference, name)
    assert type(inspect.getattr_static(Kernels, name)) is type(inspect.getattr_static(Reference, name))
    parameters = [
        [(each.name, each.kind, each.default) for each in inspect.signature(side).parameters.values()]  # type: ignore[arg-type]
        for side in (kernel, twin)
    ]
    assert parameters[0] == parameters[1]
    assert kernel.__doc__ == twin.__doc__
    assert twin.__doc__


def test_an_operation_without_a_twin_is_refused():
    def unheard_of() -> None:
        """Do nothing."""

    with pytest.raises(AttributeError, match="unheard_of"):
        operation(unheard_of)
