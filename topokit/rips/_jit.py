"""numba's `njit`, with a cache on disk that is stale as soon as any file of kernels has changed.

numba itself looks at the file of a function alone: what the function uses from other files would stay as it was compiled.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile


def source_digest(folder: Path) -> str:
    """A digest of the names and the bytes of all kernel files of a folder: those that use `njit`."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        source = path.read_bytes()
        if b"njit" in source:
            digest.update(f"{path.name} {len(source)}\n".encode() + source)
    return digest.hexdigest()


_DIGEST = source_digest(Path(__file__).parent)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function, and keep what was compiled for as long as no file of kernels changes."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        if hasattr(dispatcher, "enable_caching"):  # not when NUMBA_DISABLE_JIT is set
            dispatcher.enable_caching()  # in the folder that numba chooses, and under our digest
            cache = dispatcher._cache
            cache._cache_file = IndexDataCacheFile(
                cache.cache_path, f"{cache._impl.filename_base}-{_DIGEST[:16]}", _DIGEST
            )  # type: ignore[no-untyped-call]
        return dispatcher

    return compiled
