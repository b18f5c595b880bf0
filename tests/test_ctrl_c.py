"""Ctrl-C stays one, also when a C function has made another exception of it."""

from __future__ import annotations

import pytest
from interrupted import masked_interrupt

from clalign.ctrl_c import is_interrupt, plain_interrupts


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (KeyboardInterrupt(), True),
        (masked_interrupt(), True),
        (SystemError("a defect"), False),
        (RuntimeError("no"), False),
        (None, False),
    ],
    ids=["plain", "masked", "defect", "other", "none"],
)
def test_what_an_interrupt_is(error: BaseException | None, expected: bool) -> None:
    assert is_interrupt(error) is expected


@pytest.mark.parametrize("error", [KeyboardInterrupt(), masked_interrupt()], ids=["plain", "masked"])
def test_every_interrupt_is_raised_as_one(error: BaseException) -> None:
    @plain_interrupts()
    def work() -> None:
        raise error

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            work()


def test_a_defect_stays_a_defect() -> None:
    defect = SystemError("a defect")
    with pytest.raises(SystemError) as caught, plain_interrupts():
        raise defect
    assert caught.value is defect


def test_nothing_is_in_the_way_of_a_result() -> None:
    @plain_interrupts()
    def double(x: int) -> int:
        return 2 * x

    assert double(21) == 42
