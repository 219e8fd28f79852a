"""Dataclasses behave as those of the standard library, and nothing but their constructor is compiled."""

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from edmctl import dataclasses as quick


def _classes(dataclass: Callable[..., Any]) -> tuple[Any, Any, Any]:
    @dataclass(frozen=True, slots=True)
    class Value:
        """A value."""

        x: float
        name: str = dataclasses.field(default="n", compare=False)
        shown: Any = dataclasses.field(default=None, repr=False)

    @dataclass(slots=True)
    class State:
        """What changes."""

        x: float
        many: list[float] = dataclasses.field(default_factory=list)

    @dataclass(slots=True, eq=False)
    class Thing:
        """One of its own."""

        x: float

    return Value, State, Thing


QUICK, STANDARD = _classes(quick.dataclass), _classes(dataclasses.dataclass)


@quick.dataclass(frozen=True, slots=True)
class Named:
    """At the top of a module, for pickle."""

    x: float
    array: Any = None


def test_equality_is_that_of_the_standard_library() -> None:
    array = np.zeros(2)
    for value, state, thing in (QUICK, STANDARD):
        assert value(1.0, "a") == value(1.0, "b") != value(2.0, "a")
        assert value(1.0, shown=array) == value(1.0, shown=array)  # the same object is equal
        assert value(1.0) != state(1.0)
        assert state(1.0) == state(1.0) != state(1.0, [2.0])
        assert thing(1.0) != thing(1.0)


def test_hash_is_that_of_the_standard_library() -> None:
    for value, state, thing in (QUICK, STANDARD):
        assert {value(1.0, "a"), value(1.0, "b"), value(2.0)} == {value(1.0), value(2.0)}
        assert len({thing(1.0), thing(1.0)}) == 2
        with pytest.raises(TypeError, match="unhashable"):
            hash(state(1.0))
    assert hash(QUICK[0](1.0, "a", 3)) == hash(STANDARD[0](1.0, "b", 3))


def test_text_is_that_of_the_standard_library() -> None:
    for own, standard in zip(QUICK, STANDARD, strict=True):
        assert repr(own(1.5)) == repr(standard(1.5))
    texts = []
    for _, state, _ in (QUICK, STANDARD):
        of_itself = state(1.5)
        of_itself.many.append(of_itself)
        texts.append(repr(of_itself))
    assert texts[0] == texts[1]


def test_copies_and_pickles_are_equal() -> None:
    one = Named(1.0, [2])
    assert pickle.loads(pickle.dumps(one)) == copy.deepcopy(one) == copy.copy(one) == one
    assert dataclasses.replace(one, x=2.0) == Named(2.0, [2])
    assert dataclasses.asdict(one) == {"x": 1.0, "array": [2]}


def test_only_the_constructor_is_compiled() -> None:
    value, state, thing = QUICK
    assert value.__eq__ is state.__eq__
    assert value.__repr__ is state.__repr__ is thing.__repr__
    assert not {"__setattr__", "__delattr__", "__getstate__"} & vars(value).keys()
