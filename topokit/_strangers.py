"""Bound what files of strangers unpack to, and make their text safe to print: every reader calls this.

Idea: a small file can declare, or be packed from, far more than the memory holds. So a file of n bytes may unpack to 64 MiB and
100 times n, in all; reading it takes a few times as much. For denser files the environment variable `TOPOKIT_UNPACKED` replaces
the 64 MiB by another number of bytes.
"""

from __future__ import annotations

import os
from typing import Any

VARIABLE = "TOPOKIT_UNPACKED"
_FREE = 2**26
_RATIO = 100
_LONGEST = 1000  # characters of a message
_PIECE = 2**20  # bytes that are unpacked at a time


def free_bytes() -> int:
    """Return how many bytes any file may unpack to, however small it is."""
    text = os.environ.get(VARIABLE, str(_FREE))
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise ValueError(f"the environment variable {VARIABLE} must be a number of bytes, not {text!r:.80}")
    return int(text)


class Budget:
    """Count how many bytes a file of `size` bytes may still unpack to."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.left = free_bytes() + _RATIO * size

    def take(self, count: int) -> None:
        """Count bytes that are to be unpacked; raise ValueError when they are more than the file may hold."""
        if not 0 <= count <= self.left:
            free = free_bytes()
            most = free + _RATIO * self.size
            what = f"its {self.size} bytes claim" if self.size else "it claims"
            problem = f"{what} to hold {most - self.left + count} bytes, and {most} are unpacked at most"
            raise ValueError(f"{problem}: for such files set the environment variable {VARIABLE} to more than {free}")
        self.left -= count

    def unpack(self, decompressor: Any, data: bytes) -> bytes:
        """Return what a decompressor of the standard library's kind makes of packed bytes, a piece at a time."""
        pieces: list[bytes] = []
        fed = data
        while not decompressor.eof:
            piece = decompressor.decompress(fed, _PIECE)
            fed = b""
            if not piece and decompressor.needs_input:
                raise ValueError(f"its {len(data)} packed bytes end in the middle")
            self.take(len(piece))
            pieces.append(piece)
        return b"".join(pieces)


def check_unpacked(unpacked: int, size: int) -> None:
    """Raise ValueError when a file of `size` bytes declares that it holds more than it may."""
    Budget(size).take(unpacked)


def printable(text: object) -> str:
    """Return text of a stranger as one line without control characters: they are written as escapes, as Python writes them.

    Of a text that would fill the screen the middle is left out.
    """
    words = str(text)
    if len(words) > _LONGEST:
        words = f"{words[: _LONGEST // 2]} ... {words[-_LONGEST // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in words)
