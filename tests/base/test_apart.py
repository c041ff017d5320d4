"""Calls in processes of their own."""

import os
import signal

import pytest

from pipeline.base.apart import apart, hold

NAME = "tests.base.test_apart"


class Deadly:
    """What a library may hold: its destructor is the end. (One that waits for ever would be the
    same to the caller, and no test that ends.)
    """

    def __del__(self):
        os._exit(3)


def doubled(value):
    """Twice the value, with something held that may not be destroyed."""
    hold(Deadly())
    print("a library's own words")
    return 2 * value, os.getpid()


def refusing(value):
    """Raises what the caller is to see."""
    raise ValueError(f"not {value}")


def dying(_):
    """As a library that crashes."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_every_call_has_a_process_of_its_own_that_nothing_holds_back():
    with apart(NAME, "doubled") as call:
        first, second = call(2), call([1])
    assert (first[0], second[0]) == (4, [1, 1])
    assert len({first[1], second[1], os.getpid()}) == 3


def test_what_a_call_raises_is_raised_here_and_the_next_call_goes_on():
    with apart(NAME, "refusing") as call:
        for value in (1, 2):
            with pytest.raises(ValueError, match=f"not {value}"):
                call(value)


def test_a_call_whose_process_dies_is_an_error_and_no_endless_wait():
    with apart(NAME, "dying") as call, pytest.raises(RuntimeError, match=f"{NAME}.dying"):
        call(1)
