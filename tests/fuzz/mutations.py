"""Damaged copies of valid files, addressed by a seed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

Draw = np.random.Generator
#: Numbers at the edges of integer types.
EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
#: Words that replace numbers and values in text files.
WORDS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "-1", "0", "-0.0", "9" * 40, "0x7f"),
    *('""', "''", "[]", "{}", "[[]]", "true", "null", "None", '"1 m"', '"1e400 m"', '"-1 m"'),
    *('"\\u0000"', '"../../../"', '"."', '"/dev/zero"', "[1, 2, 3, 4]", '"ohm"', "{a = 1}"),
)
NUMBER = re.compile(rb"-?\d[\d.eE+-]*")


def mutated(content: bytes, others: Sequence[bytes], draw: Draw, *, text: bool) -> bytes:
    """Return a damaged copy of a file's content.

    Parameters
    ----------
    content : bytes
        Content of a valid file.
    others : sequence of bytes
        Contents of other valid files, parts of which may be inserted.
    draw : numpy.random.Generator
        Source of all random decisions.
    text : bool
        Whether lines and numbers are changed besides bytes.
    """
    ways: list[Callable[[bytes, Draw], bytes]] = [_bits, _bytes, _number, _cut, _again, _shorter]
    if text:
        ways += 4 * [_word] + [_without_line, _line_again, _lines_swapped]
    for _ in range(int(draw.choice((1, 1, 1, 2, 3, 8)))):
        if draw.random() < 0.05 and others:
            content = _spliced(content, others[int(draw.integers(len(others)))], draw)
        else:
            content = ways[int(draw.integers(len(ways)))](content, draw)
    return content


def _place(content: bytes, draw: Draw) -> int:
    """Return an offset; half of the time near the start, where headers are."""
    end = max(len(content), 1)
    return int(draw.integers(min(end, 256) if draw.random() < 0.5 else end))


def _span(content: bytes, draw: Draw) -> tuple[int, int]:
    start = _place(content, draw)
    return start, start + int(2 ** draw.uniform(0, 10))


def _bits(content: bytes, draw: Draw) -> bytes:
    found = bytearray(content)
    if found:
        found[_place(content, draw)] ^= 1 << int(draw.integers(8))
    return bytes(found)


def _bytes(content: bytes, draw: Draw) -> bytes:
    start, stop = _span(content, draw)
    return content[:start] + draw.bytes(min(stop, len(content)) - start) + content[stop:]


def _number(content: bytes, draw: Draw) -> bytes:
    """Overwrite an integer of 1 to 8 bytes by one at the edge of a type."""
    start, size = _place(content, draw), int(draw.choice((1, 2, 4, 8)))
    value = EDGES[int(draw.integers(len(EDGES)))] % 256**size
    order = "little" if draw.random() < 0.7 else "big"
    return content[:start] + value.to_bytes(size, order) + content[start + size :]


def _cut(content: bytes, draw: Draw) -> bytes:
    start, stop = _span(content, draw)
    return content[:start] + content[stop:]


def _again(content: bytes, draw: Draw) -> bytes:
    start, stop = _span(content, draw)
    return content[:stop] + content[start:stop] * int(draw.integers(1, 4)) + content[stop:]


def _shorter(content: bytes, draw: Draw) -> bytes:
    return content[: _place(content, draw)]


def _spliced(content: bytes, other: bytes, draw: Draw) -> bytes:
    return content[: _place(content, draw)] + other[_place(other, draw) :]


def _word(content: bytes, draw: Draw) -> bytes:
    """Replace a number, or what follows a sign of equality, by a word."""
    word = WORDS[int(draw.integers(len(WORDS)))].encode()
    found = list(NUMBER.finditer(content))
    if found and draw.random() < 0.6:
        one = found[int(draw.integers(len(found)))]
        return content[: one.start()] + word + content[one.end() :]
    lines = content.split(b"\n")
    index = int(draw.integers(len(lines)))
    lines[index] = lines[index].split(b"=")[0] + b"= " + word
    return b"\n".join(lines)


def _without_line(content: bytes, draw: Draw) -> bytes:
    lines = content.split(b"\n")
    del lines[int(draw.integers(len(lines)))]
    return b"\n".join(lines)


def _line_again(content: bytes, draw: Draw) -> bytes:
    lines = content.split(b"\n")
    lines.insert(int(draw.integers(len(lines))), lines[int(draw.integers(len(lines)))])
    return b"\n".join(lines)


def _lines_swapped(content: bytes, draw: Draw) -> bytes:
    lines = content.split(b"\n")
    one, other = draw.integers(len(lines), size=2)
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)
