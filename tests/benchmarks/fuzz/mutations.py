"""Mutations of files: of bytes for all formats, of words and lines for texts."""

from __future__ import annotations

import numpy as np

# Bytes that readers take for sizes, counts and signs.
_TELLING = [
    b"\x00",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\xff" * 8,
    b"\x00" * 16,
    b"\x01\x00",
]
_WORDS = [
    "nan", "inf", "-inf", "1e999", "-1e308", "1e-320", "-1", "0", "-0.0", "9" * 30, "9223372036854775808", "0x10",
    "1_0", "1,5", "", "a", "\u0661", "\x00", "\u202e", "é", "~", "null", "[]", "{}", "!!python/object:os.system", "*a",
    "&a", "<<", "../../x", "/etc/passwd", ":", "-", "#", "%", "'", '"', "\t", "1" * 5000,
]  # fmt: skip


def mutated(data: bytes, other: bytes, rng: np.random.Generator, *, is_text: bool) -> bytes:
    """Change a file by one to four mutations."""
    for _ in range(int(rng.integers(1, 5))):
        as_text = is_text and rng.random() < 0.75
        data = _changed_text(data, rng) if as_text else _changed_bytes(data, other, rng)
    return data


def _changed_bytes(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    size = len(data)
    # Headers decide more than pixels: half of all places are among the first 128 bytes.
    at = int(rng.integers(0, min(size, 128) + 1 if rng.random() < 0.5 else size + 1))
    length = int(rng.choice([1, 2, 4, 8, 64, 1024]))
    telling = _TELLING[int(rng.integers(len(_TELLING)))]
    match int(rng.integers(7)):
        case 0 if at < size:
            return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
        case 1:
            return data[:at] + telling + data[at + len(telling) :]
        case 2:
            return data[:at] + data[at + length :]
        case 3:
            return data[:at] + data[at : at + length] * int(rng.choice([2, 3, 50])) + data[at + length :]
        case 4:
            return data[:at] + rng.bytes(length) + data[at + length :]
        case 5:
            return data[:at]
        case _:
            begin = int(rng.integers(0, len(other) + 1))
            return data[:at] + other[begin : begin + length] + data[at:]


def _changed_text(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.decode("utf-8", "surrogateescape").split("\n")
    at = int(rng.integers(len(lines)))
    word = _WORDS[int(rng.integers(len(_WORDS)))]
    match int(rng.integers(6)):
        case 0 | 1:
            separator = "," if "," in lines[at] else " "
            words = lines[at].split(separator)
            words[int(rng.integers(len(words)))] = word
            lines[at] = separator.join(words)
        case 2:
            lines[at] = word
        case 3:
            lines.insert(at, lines[int(rng.integers(len(lines)))])
        case 4:
            del lines[at]
        case _:
            rng.shuffle(lines)
    return "\n".join(lines).encode("utf-8", "surrogateescape")
