"""Calls each in a process of its own, for a library that may never come back from its clean-up.

A process started once imports the function; for every call it forks, and the fork ends as soon as
its result is out, without destructors. What the library holds goes back to the system with it.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Protocol

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")  # threads do not fork
_held: list[Any] = []


class Call(Protocol):
    def __call__(self, *args: Any) -> Any: ...


def module_environment() -> dict[str, str]:
    """Environment of a program started by `python -m`, so that it finds what this process finds."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(["", *sys.path])}


def hold(value: Any) -> None:
    """Keep `value` from being destroyed while this process lives."""
    _held.append(value)


@contextmanager
def apart(module: str, function: str) -> Iterator[Call]:
    """A function of a module that is called in a process of its own each time; arguments and result
    go there and back through pipes. A call raises what the function raises, and RuntimeError where
    its process dies.
    """
    command = [sys.executable, "-m", "pipeline.base.apart", module, function]
    environment = module_environment() | dict.fromkeys(ONE_THREAD, "1")
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        requests = Connection(os.dup(process.stdin.fileno()), readable=False)
        answers = Connection(os.dup(process.stdout.fileno()), writable=False)

        def call(*args: Any) -> Any:
            try:
                requests.send(args)
                result, error = answers.recv()
            except (EOFError, OSError) as gone:
                raise RuntimeError(f"the process of {module}.{function} ended early") from gone
            if error is not None:
                raise error
            return result

        with requests, answers:
            yield call


def _answer(function: Call, args: tuple, answers: Connection) -> None:
    """Send the call's result, or what it raised."""
    try:
        result = function(*args)
    except Exception as error:  # raised again by the caller
        answers.send((None, error))
    else:
        answers.send((result, None))


def _fork(function: Call, args: tuple, answers: Connection) -> bool:
    """`_answer` by a process of its own, and whether it came to its end."""
    child = os.fork()
    if child == 0:
        try:
            _answer(function, args, answers)
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitpid(child, 0)[1] == 0


def main() -> None:
    """Take arguments from standard input and give results to standard output until it ends."""
    module, function = sys.argv[1:]
    called = getattr(importlib.import_module(module), function)
    requests = Connection(os.dup(0), writable=False)
    answers = Connection(os.dup(1), readable=False)
    os.dup2(2, 1)  # what a library prints is no answer
    while True:
        try:
            args = requests.recv()
        except EOFError:
            return
        if not _fork(called, args, answers):
            sys.exit(1)


if __name__ == "__main__":
    main()
