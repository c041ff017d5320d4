"""Good files made bad at random: by bytes, by the words of a text, by the values of a tree.

Every function takes its randomness from a generator that is passed in.
"""

from __future__ import annotations

import copy
import re
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

PNG = b"\x89PNG\r\n\x1a\n"
NUMBERS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**63,
    2**64 - 1,
)
WORDS = (
    *("nan", "-inf", "1e400", "-1", "0", "1e-320", "9" * 400, "0x10", "1_000", "", "null", "true"),
    *("'", '"', "{", "[", "}", "~", "!!binary", "&a", "*a", "%", "#", "\t", "\0", "\ufeff", "é🪑"),
    *("../..", "/", "a/b", "x" * 300, "-0.0", "1/2", "2020-13-45", "<<", "e", "1e5", "-2147483649"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2**31, 2**63, 10**400, 0.5, 1e300, 1e-300, float("nan")),
    *(float("inf"), -float("inf"), "", "x", "1", "nan", "\0", "\ud800", "..", "/", "é" * 200),
    *([], {}, [[]], [None], {"": 0}, {"a": {"b": []}}, [1, 2, 3], list(range(20))),
)
MOST = 4  # changes of one file


def mutated_bytes(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A file with 1 to MOST changes; other: from which pieces are taken, too."""
    out = bytearray(data)
    for _ in range(_changes(rng)):
        change = BYTE_CHANGES[rng.integers(len(BYTE_CHANGES))]
        change(out, other, rng)
    if out.startswith(PNG) and rng.random() < 0.8:
        return with_checksums(bytes(out))
    return bytes(out)


def _changes(rng: np.random.Generator) -> int:
    """How many: mostly 1, since a reader stops at the first that it does not like."""
    return int(min(rng.geometric(0.6), MOST))


def _span(length: int, rng: np.random.Generator) -> slice:
    """A piece of a file, short or long."""
    start = int(rng.integers(length + 1))
    return slice(start, start + int(2 ** rng.uniform(0, 1 + np.log2(length + 1))))


def _flip(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    if out:
        out[rng.integers(len(out))] ^= 1 << int(rng.integers(8))


def _noise(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    span = _span(len(out), rng)
    out[span] = rng.bytes(len(out[span]))


def _cut(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    del out[rng.integers(len(out) + 1) :]


def _remove(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    del out[_span(len(out), rng)]


def _double(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    span = _span(len(out), rng)
    out[span.start : span.start] = out[span]


def _splice(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    place = int(rng.integers(len(out) + 1))
    out[place:place] = other[_span(len(other), rng)]


def _number(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    """A count, an offset or a size: an integer of 1 to 8 bytes, more often near the beginning."""
    width = int(rng.choice([1, 2, 4, 8]))
    place = int(len(out) * rng.random() ** 3)
    value = int(rng.choice(np.array(NUMBERS, object))) % 256**width
    out[place : place + width] = value.to_bytes(width, "little" if rng.random() < 0.5 else "big")


def _real(out: bytearray, other: bytes, rng: np.random.Generator) -> None:
    value = rng.choice([np.nan, np.inf, -1e300, 1e-320, 0.0, 1e38])
    kind = "<d" if rng.random() < 0.5 else "<f"
    with np.errstate(over="ignore"):
        packed = np.array(value, kind).tobytes()
    place = int(rng.integers(len(out) + 1))
    out[place : place + len(packed)] = packed


BYTE_CHANGES: tuple[Callable[[bytearray, bytes, np.random.Generator], None], ...] = (
    *(_flip, _flip, _noise, _cut, _remove, _double, _splice, _number, _number, _real),
)


def with_checksums(png: bytes) -> bytes:
    """A PNG whose chunks have the checksums that belong to them, so that what they say is read."""
    out = bytearray(png)
    place = len(PNG)
    while place + 12 <= len(out):
        (length,) = struct.unpack_from(">I", out, place)
        end = place + 8 + length
        if end + 4 > len(out):
            break
        struct.pack_into(">I", out, end, zlib.crc32(bytes(out[place + 4 : end])))
        place = end + 4
    return bytes(out)


def mutated_text(text: str, rng: np.random.Generator) -> str:
    """A text with 1 to MOST of its words, numbers, signs or lines changed."""
    for _ in range(_changes(rng)):
        lines = text.split("\n")
        pieces = re.split(r"(\s+|[,:\[\]{}/]|-?\d[\d.eE+-]*)", text)
        at = int(rng.integers(len(pieces)))
        line, other = rng.integers(len(lines), size=2)
        match rng.integers(6):
            case 0 | 1 | 2:
                pieces[at] = str(rng.choice(np.array(WORDS, object)))
                text = "".join(pieces)
            case 3:
                text = "".join(pieces[:at] + pieces[at + 1 :])
            case 4:
                lines.insert(line, lines[other])
                text = "\n".join(lines)
            case _:
                del lines[line]
                text = "\n".join(lines)
    return text


def mutated_tree(tree: Any, rng: np.random.Generator) -> Any:
    """A tree of dicts and lists with 1 to MOST entries replaced, removed, doubled or renamed."""
    tree = copy.deepcopy(tree)
    for _ in range(_changes(rng)):
        places = list(_places(tree))
        if not places:
            return VALUES[rng.integers(len(VALUES))]
        parent, key = places[rng.integers(len(places))]
        value = VALUES[rng.integers(len(VALUES))]
        match rng.integers(4):
            case 0:
                del parent[key]
            case 1 if isinstance(parent, dict):
                parent[str(rng.choice(np.array(WORDS, object)))] = parent.pop(key)
            case 1:
                parent.insert(key, copy.deepcopy(parent[key]))
            case _:
                parent[key] = copy.deepcopy(value)
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """(container, key) of every entry."""
    if not isinstance(tree, (dict, list)):
        return []
    own = [(tree, key) for key in (list(tree) if isinstance(tree, dict) else range(len(tree)))]
    return own + [place for _, key in own for place in _places(tree[key])]
