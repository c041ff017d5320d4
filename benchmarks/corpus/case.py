"""What a case of the corpus is, and the list of all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from benchmarks.corpus.project import Project

CASES: list[Case] = []


@dataclass(frozen=True)
class Case:
    """Bad input and how it must end.

    spoil: changes a good project; stages: are run one after the other until one stops; words: all
    of them stand in the message; check: raises AssertionError where the result is not right.
    Exactly one of `words` and `check` is given. heavy: takes long, or much disk. inside: is called
    in the stage's process before it; surroundings: environment variables.
    """

    group: str
    name: str
    spoil: Callable[[Project], None]
    stages: tuple[str, ...] = ("capture",)
    words: tuple[str, ...] = ()
    check: Callable[[Project], None] | None = None
    heavy: bool = False
    options: tuple[str, ...] = ()
    surroundings: dict[str, str] = field(default_factory=dict)
    scene: str = "s"
    photos: str = "photos"
    timeout: float = 60.0
    inside: Callable[[], None] | None = None

    @property
    def expected(self) -> str:
        return "message" if self.words else "result"


def message(group: str, name: str, *words: str, **more) -> Callable:
    """Decorator of a function that spoils a project: it must end in a message with these words."""

    def register(spoil: Callable[[Project], None]) -> Callable[[Project], None]:
        CASES.append(Case(group, name, spoil, words=words, **more))
        return spoil

    return register


def result(group: str, name: str, check: Callable[[Project], None], **more) -> Callable:
    """Decorator of a function that spoils a project: the result must be right all the same."""

    def register(spoil: Callable[[Project], None]) -> Callable[[Project], None]:
        CASES.append(Case(group, name, spoil, check=check, **more))
        return spoil

    return register
