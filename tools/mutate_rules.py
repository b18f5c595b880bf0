"""Change every number of the rules in turn, run tests on each change, and say which rules no test notices.

``python tools/mutate_rules.py [--rules clalign.rules.Rules] [--only search.oriented] [TESTS ...]``

Any frozen dataclass can be named; the dataclasses that its fields hold are gone through as well. Floats are multiplied
and divided by 1.5, so are whole numbers from 10 on, and smaller ones get one more and one less; a zero float becomes
0.1; truth values are negated; of tuples each element is changed like that, and dropped.

No source is edited: the tests run with ``-p mutate_rules``, and this module, loaded as a plugin, changes the default of
one field as the environment variable ``MUTATED_RULE`` says, before anything else of the package is imported. Tests that
build the rules with values of their own, or in other processes, do not see it.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

VARIABLE = "MUTATED_RULE"
FACTOR = 1.5
SMALL = 10
TESTS = ("tests/matching", "tests/search", "tests/refinement")
Steps = tuple[str, ...]


def changed(value: Any, change: str) -> Any:
    """Return a number or truth value after a change: "up", "down" or "not"."""
    if change == "not":
        return not value
    if value == 0:
        return 1 if isinstance(value, int) else 0.1
    if isinstance(value, float):
        return value * FACTOR if change == "up" else value / FACTOR
    if abs(value) < SMALL:
        return value + 1 if change == "up" else value - 1
    return round(value * FACTOR) if change == "up" else round(value / FACTOR)


def mutated(value: Any, path: Steps, change: str) -> Any:
    """Return a value, of which the part that a path of field names and indices leads to has changed."""
    if not path:
        return changed(value, change)
    first, *rest = path
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.replace(value, **{first: mutated(getattr(value, first), tuple(rest), change)})
    index = int(first)
    if change == "drop" and not rest:
        return value[:index] + value[index + 1 :]
    return (*value[:index], mutated(value[index], tuple(rest), change), *value[index + 1 :])


def changes_of(value: Any, path: Steps = ()) -> Iterator[tuple[Steps, str]]:
    """Yield every path into a default value with every change that can be made there."""
    if isinstance(value, bool):
        yield path, "not"
    elif isinstance(value, int | float):
        yield from ((path, change) for change in (("up", "down") if value else ("up",)))
    elif isinstance(value, tuple):
        for index, element in enumerate(value):
            yield from changes_of(element, (*path, str(index)))
            yield (*path, str(index)), "drop"
    elif dataclasses.is_dataclass(value):
        for entry in dataclasses.fields(value):
            yield from changes_of(getattr(value, entry.name), (*path, entry.name))


def mutations(kind: type[Any]) -> Iterator[tuple[str, Steps, str]]:
    """Yield class, path and change of every mutation of a dataclass and of those that its fields make."""
    for entry in dataclasses.fields(kind):
        factory = entry.default_factory
        if isinstance(factory, type) and dataclasses.is_dataclass(factory):
            yield from mutations(factory)
        elif entry.default is not dataclasses.MISSING:
            name = f"{kind.__module__}.{kind.__qualname__}"
            yield from ((name, path, change) for path, change in changes_of(entry.default, (entry.name,)))


def named_class(name: str) -> type[Any]:
    """Return a class by its module and name."""
    module, _, own = name.rpartition(".")
    found: type[Any] = getattr(importlib.import_module(module), own)
    return found


def change_default(kind: type[Any], path: Steps, change: str) -> None:
    """Change the default of a field of a dataclass, for all instances that are made from now on."""
    name, *rest = path
    value = mutated(getattr(kind, name), tuple(rest), change)
    setattr(kind, name, value)
    kind.__dataclass_fields__[name].default = value
    start: Any = kind.__init__
    optional = [
        p.name for p in inspect.signature(start).parameters.values() if p.default is not inspect.Parameter.empty
    ]
    defaults = dict(zip(optional, start.__defaults__, strict=True))
    start.__defaults__ = tuple((defaults | {name: value}).values())


def run_tests(mutation: str, tests: list[str]) -> tuple[bool, str]:
    """Run tests with one mutation ("" for none) until one fails; return whether all passed, and the last line."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "mutate_rules", "-p", "no:cacheprovider", *tests]
    search = os.pathsep.join(filter(None, (str(Path(__file__).parent), os.environ.get("PYTHONPATH", os.getcwd()))))
    environment = {**os.environ, "PYTHONPATH": search, VARIABLE: mutation, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines() or done.stderr.strip().splitlines() or [""]
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return done.returncode == 0, (failed or lines)[-1][:160]


def main() -> int:
    """Run every mutation; 1 when a rule is noticed by no test."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tests", metavar="TESTS", nargs="*", default=list(TESTS), help=f"default: {' '.join(TESTS)}")
    parser.add_argument("--rules", metavar="CLASS", default="clalign.rules.Rules", help="default: %(default)s")
    parser.add_argument("--only", metavar="TEXT", default="", help="rules whose name holds this")
    parser.add_argument("--every", action="store_true", help="all changes of a rule, not only until one is noticed")
    parser.add_argument("--list", action="store_true", help="name the mutations and run nothing")
    args = parser.parse_args()
    rules: dict[str, list[str]] = {}
    for kind, path, change in mutations(named_class(args.rules)):
        rule = f"{kind.rpartition('.')[2]}.{'.'.join(path)}"
        if args.only in rule:
            rules.setdefault(rule, []).append(f"{kind} {'.'.join(path)} {change}")
    if args.list:
        sys.stdout.write("".join(f"{mutation}\n" for each in rules.values() for mutation in each))
        return 0
    start = time.perf_counter()
    passed, line = run_tests("", args.tests)
    if not passed:
        sys.stderr.write(f"the tests fail without a mutation: {line}\n")
        return 2
    count = sum(map(len, rules.values()))
    sys.stdout.write(f"{len(rules)} rules, {count} mutations; {time.perf_counter() - start:.0f} s without one\n")
    unnoticed = []
    for rule, each in rules.items():
        noticed = False
        for mutation in each:
            passed, line = run_tests(mutation, args.tests)
            noticed |= not passed
            sys.stdout.write(f"{'UNNOTICED' if passed else 'noticed'} {mutation}{'' if passed else f': {line}'}\n")
            sys.stdout.flush()
            if noticed and not args.every:
                break
        if not noticed:
            unnoticed.append(rule)
    sys.stdout.write("".join(f"no test notices {rule}\n" for rule in unnoticed) or "every rule is noticed\n")
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main())
elif os.environ.get(VARIABLE):
    class_name, dotted, kind_of_change = os.environ[VARIABLE].split()
    change_default(named_class(class_name), tuple(dotted.split(".")), kind_of_change)
