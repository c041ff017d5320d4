"""No test is bound to one seed: `--seed-offset` reaches every generator of the tests."""

import ast
from pathlib import Path

import numpy as np
import pytest

from tests import seeds
from tests.conftest import TESTS
from tests.seeds import numpy_rng, seeded, torch_rng

MAKERS = {"default_rng", "manual_seed", "RandomState"}


def bound(source: str) -> list[int]:
    """Lines that make a generator of a seed that does not move: not of `seeded(...)`."""
    found = []
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and getattr(call.func, "attr", None) in MAKERS:
            inside = [node for argument in call.args for node in ast.walk(argument)]
            names = {getattr(node, "id", getattr(node, "attr", None)) for node in inside}
            if "seeded" not in names:
                found.append(call.lineno)
    return found


def test_every_generator_of_the_tests_moves_with_the_offset():
    for file in set(TESTS.rglob("*.py")) - {Path(__file__)}:  # its own stay, to compare with
        assert bound(file.read_text(encoding="utf-8")) == [], file


def test_an_offset_moves_every_seed(monkeypatch, pytestconfig):
    assert seeded(3) == 3 + pytestconfig.getoption("--seed-offset")
    monkeypatch.setattr(seeds, "offset", 5)
    assert seeded(3) == 8
    assert numpy_rng(3).random() == np.random.default_rng(8).random()
    assert torch_rng(3).initial_seed() == 8


@pytest.mark.parametrize(
    "source, lines",
    [
        ("a = 1\nrng = np.random.default_rng(0)", [2]),
        ("torch.Generator().manual_seed(k)", [1]),
        ("torch.manual_seed(seeded(0))", []),
        ("np.random.default_rng([settings.seed, 3])", [1]),
        ("np.random.default_rng([0, seeded(3)])", []),
    ],
)
def test_a_seed_that_stays_is_found(source, lines):
    assert bound(source) == lines
