"""The compiler: numba, imported when it pays, and a private folder for what it compiled.

Idea: numba keeps compiled code as pickles, whose reading runs code, and a file `.numba_config.yaml` in the working directory
may tell it where they are. So topokit reads and writes its compiled code itself. It is in the user's cache folder, or where the
user's environment says (NUMBA_CACHE_DIR), and no file in the working directory has a say. The name of a file tells without
numba whether a function is compiled for this source, this numba and this processor.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import pkgutil
import platform
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_KEPT = 8  # files a function: other versions of it, other Pythons and processors
_said: set[str] = set()
_failed: list[Exception] = []  # why numba could not be imported


def is_usable() -> bool:
    """Return True if numba is installed and was not seen to fail, without importing it."""
    return not _failed and _place_of_numba() is not None


@cache
def _place_of_numba() -> str | None:
    spec = find_spec("numba")
    return spec.origin if spec else None


def imports() -> bool:
    """Import numba; return False where that fails, as for a version of NumPy that it does not know yet."""
    try:
        import numba  # noqa: F401
    except Exception as error:  # numba runs much at its import, and reads a file of settings
        _failed.append(error)
        say_once(f"numba cannot be imported, so clouds are paired without it, which takes longer ({error})")
    return not _failed


@cache
def is_compiled(function: str) -> bool:
    """Return True if a function of `kernel` was compiled by an earlier process and kept, without importing numba."""
    folder = _folder(make=False)
    return folder is not None and any(folder.glob(f"{function}-{_fingerprint()}-*"))


@cache
def seconds_before() -> float:
    """Return the seconds that earlier processes spent in plain Python where this kernel was not compiled."""
    folder = _folder(make=False)
    if folder is None:
        return 0.0
    seconds = 0.0
    with contextlib.suppress(OSError, ValueError):
        seconds = sum(map(float, (folder / _file_of_seconds()).read_text(encoding="ascii").split()))
    return seconds


def add_seconds(seconds: float) -> None:
    """Keep the seconds that this process spent in plain Python, for later processes."""
    folder = _folder(make=True)
    if folder is not None:
        with contextlib.suppress(OSError), open(folder / _file_of_seconds(), "a", encoding="ascii") as file:
            file.write(f"{seconds:.1f}\n")


def _file_of_seconds() -> str:
    return f"seconds-{_fingerprint()}"


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's decorator; with `cache`, what it compiles is kept by this module, and Python can call it.

    Other functions are compiled into those alone. A way to call them from Python would take a fifth of the time of compiling.
    """
    import numba

    def decorate(function: Callable[..., Any]) -> Any:
        wrappers: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": not cache}
        compiled = numba.njit(error_model="numpy", **options, **wrappers)(function)
        if cache and hasattr(compiled, "py_func"):  # numba can be told to compile nothing
            compiled._cache = _kept(function.__name__)
        return compiled

    return decorate


def say_once(message: str) -> None:
    """Print a sentence on stderr, once a process."""
    if message not in _said:
        _said.add(message)
        print(f"topokit: {message}", file=sys.stderr, flush=True)


# The folder -----------------------------------------------------------------------------------------------------------


def _folder(*, make: bool) -> Path | None:
    """Return the folder of compiled code; None where there is none, or others might write to it."""
    try:
        _fingerprint()  # fails where there are no sources, as in one file made of a program
        folder = _cache_of_the_user() / "topokit"
        if not folder.is_absolute():
            return None
        if make:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except (OSError, RuntimeError):  # the second: Python knows no home
        return None
    if os.name == "posix" and (found.st_uid not in (0, os.geteuid()) or found.st_mode & 0o022):
        return None
    return folder


def _cache_of_the_user() -> Path:
    """Return where programs keep what they can make again."""
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        if os.environ.get(variable):
            return Path(os.environ[variable])
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    return Path.home() / ".cache"


@cache
def _fingerprint() -> str:
    """Return a digest of all that compiled code depends on: the source, Python, numba, and the processor."""
    where = _place_of_numba() or ""
    installed = os.stat(where)
    parts = (
        pkgutil.get_data(__package__, "kernel.py"),
        sys.version,
        where,
        (installed.st_mtime_ns, installed.st_size),
        platform.machine(),
        _processor(),
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _processor() -> str:
    """Return the name and the abilities of the processor where Linux tells them."""
    lines = []
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        for line in file:
            if not line.strip():  # the other cores follow
                break
            if line.startswith(("model name", "flags", "Features", "CPU part")):
                lines.append(line)
    return "".join(lines)


# What numba asks of a cache -------------------------------------------------------------------------------------------


def _kept(function: str) -> Any:
    """Return what numba asks for compiled code of a function before it compiles, and hands it to afterwards."""
    from numba import __version__
    from numba.core.caching import NullCache

    compiler: Any = import_module("numba.core.compiler")  # what follows has no types
    serialize: Any = import_module("numba.core.serialize")

    class Kept(NullCache):
        """Compiled code of a function, a file for each signature."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            """Return the code for a signature, None if there is none for this machine."""
            target_context.refresh()
            folder = _folder(make=False)
            if folder is None:
                return None
            made_for = (__version__, sig, target_context.codegen().magic_tuple())
            try:
                content = self._path(folder, sig).read_bytes()
                found_for, parts = pickle.loads(content)
                if found_for != made_for:
                    return None
                return compiler.CompileResult._rebuild(target_context, *parts)
            except FileNotFoundError:
                return None
            except Exception as error:  # a damaged pickle may raise anything
                say_once(f"the compiled code in {folder} cannot be read, so it is compiled again ({error})")
                return None

        def save_overload(self, sig: Any, cres: Any) -> None:
            """Keep the code of a signature if there is a place for it."""
            made_for = (__version__, sig, cres.codegen.magic_tuple())
            content = serialize.dumps((made_for, cres._reduce()))
            folder = _folder(make=True)
            if folder is None:
                say_once(
                    "compiled code is not kept, as its folder cannot be made or others may write to it; set NUMBA_CACHE_DIR"
                )
                return
            try:
                _write(self._path(folder, sig), content)
                _remove_old(folder)
            except OSError as error:
                say_once(f"compiled code is not kept, so the next process compiles it again ({error})")

        def _path(self, folder: Path, sig: Any) -> Path:
            return folder / f"{function}-{_fingerprint()}-{hashlib.sha256(repr(sig).encode()).hexdigest()[:8]}"

    def _remove_old(folder: Path) -> None:
        newest_first = sorted(folder.glob(f"{function}-*"), key=lambda path: -path.stat().st_mtime)
        for path in newest_first[_KEPT:]:
            path.unlink(missing_ok=True)

    return Kept()


def _write(path: Path, content: bytes) -> None:
    """Write a file as a whole or not at all."""
    number, temporary = tempfile.mkstemp(prefix=".", dir=path.parent)
    try:
        with open(number, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
