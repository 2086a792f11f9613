"""The file of results: read and written, and the code that it is made by."""

from __future__ import annotations

import ast
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import topokit
from topokit._archive import FormatError, atomic_file

KIND = "topokit-evaluation"


def read_results(path: str | Path) -> dict[str, Any]:
    """Read a file that `evaluate_forecasts` wrote.

    Raises
    ------
    FileNotFoundError, FormatError
        When there is none, or it is something else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file; topokit evaluate makes it")
    try:
        results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if results["kind"] != KIND:
            raise KeyError("kind")
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{path}: holds no results of topokit evaluate; take another name for --out") from error
    return results


def write_results(path: str | Path, results: Mapping[str, Any]) -> None:
    """Write results as JSON with a line for every innermost object or list; the file is replaced in one piece."""
    text = json.dumps(results, indent=1, allow_nan=False)
    for innermost in (r"\{[^][{}]*\}", r"\[[^][{}]*\]"):
        text = re.sub(innermost, lambda match: re.sub(r"\s+", " ", match[0]), text)
    with atomic_file(path) as handle:
        handle.write(f"{text}\n".encode())


@cache
def library_digest(package: Path = Path(topokit.__file__).parent) -> str:
    """Return a name for the code that numbers are made by: all modules of a package but those that draw.

    Words about the code, comments and docstrings, do not count.
    """
    paths = sorted(path for path in package.rglob("*.py") if "view" not in path.relative_to(package).parts)
    trees = [_WithoutWords().visit(ast.parse(path.read_bytes())) for path in paths]
    names = [path.relative_to(package).as_posix() for path in paths]
    return digest([names, *map(ast.dump, trees)])


class _WithoutWords(ast.NodeTransformer):
    """Takes out every string that is a statement of its own."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        words = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if words else node


def digest(parts: Sequence[Any]) -> str:
    """Return a name for anything that JSON can hold."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]
