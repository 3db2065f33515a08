"""How functions are compiled for the processor: what is promised of them, and what is kept."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import cache
from inspect import unwrap
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from llvmlite import binding as llvm
from numba import config, njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

# Fused multiply-adds are allowed; infinities and NaN stay what they are.
FAST = frozenset({"contract", "nsz"})
LONG = 120.0  # seconds that a process waits for what another compiles


class _Whole(JITCodeLibrary):
    """Machine code that calls its own copies of what it calls, compiled with it.

    Copies that others may share are numba's way. A process that compiles has each function by
    itself before its callers, whose calls then lead to it; one that loads kept code has the
    callers' copies alone. The two are compiled in other surroundings, and round otherwise.
    """

    def _finalize_final_module(self) -> None:
        module = self._final_module
        self._shared_module = module.clone()  # what callers are compiled with, as numba makes it
        for function in self._shared_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
        for function in module.functions:
            if function.linkage == llvm.Linkage.linkonce_odr:
                function.linkage = "internal"
        super()._finalize_final_module()


class _Alone(Compiler):
    """Compiles into a :class:`_Whole`."""

    def define_pipelines(self) -> Any:
        name = self.state.func_id.func_qualname
        self.state.library = _Whole(self.state.targetctx.codegen(), name)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class _Apart(_Alone):
    """Promises that the arrays of a call lie apart.

    Without that no table can be looked up in a loop that also writes: each entry might be what
    was just written.
    """

    def define_pipelines(self) -> Any:
        self.state.flags.noalias = True
        return super().define_pipelines()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function whose arrays lie apart; it holds no lock that other threads wait for."""
    return _compiled(function, nogil=True, pipeline_class=_Apart)


def summing(function: Callable[..., Any]) -> Any:
    """The same for a function whose sums may be taken in any order, and so by vectors."""
    return _compiled(function, nogil=True, pipeline_class=_Apart, fastmath={*FAST, "reassoc"})


def uncounted(function: Callable[..., Any], inline: bool = False) -> Any:
    """The same for a function that makes no arrays, and so need not count their references.

    To count them costs as much as what is done on a few lanes, and so does a call: an array is
    handed over as eight numbers.

    Args:
        function: to compile.
        inline: into its callers.
    """
    return _compiled(function, nogil=True, pipeline_class=_Apart, forceinline=inline, _nrt=False)


def part(function: Callable[..., Any]) -> Any:
    """The same, compiled into its callers: where a call would take as long as what it does."""
    return uncounted(function, inline=True)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into its callers."""
    return _compiled(function, forceinline=True, pipeline_class=_Alone)


def instructions(written: Callable[..., Any], plainly: Callable[..., Any]) -> Any:
    """A function of our own instructions, in numpy where numba is told to compile nothing."""
    compiles = not getattr(config, "DISABLE_JIT")  # noqa: B009 (numba sets it when imported)
    return intrinsic(unwrap(written)) if compiles else plainly


def _compiled(
    function: Callable[..., Any], fastmath: frozenset[str] | set[str] = FAST, **options: Any
) -> Any:
    # Unwrapped, because checks of types that tests put around a function cannot be compiled.
    fast = njit(fastmath=set(fastmath), error_model="numpy", cache=True, **options)
    made: Any = fast(unwrap(function))
    if isinstance(made, Dispatcher):  # not where numba is told to compile nothing
        kept: Any = made._cache  # type: ignore[attr-defined]
        _keep_apart(kept._cache_file, _folders(made.py_func))
        made.compile = _by_one(made.compile, kept)  # type: ignore[method-assign, assignment]
    return made


def _by_one(compile_: Callable[[Any], Any], kept: Any) -> Callable[[Any], Any]:
    """Of processes that start together one compiles, and the others wait and read what it keeps."""
    lock = FileLock(Path(kept.cache_path) / f"{kept._impl.filename_base}.lock")

    def compiled(signature: Any) -> Any:
        with global_compiler_lock, ExitStack() as held:  # numba's first: its threads wait for it
            with suppress(OSError, Timeout):
                kept._impl.locator.ensure_cache_path()
                held.enter_context(lock.acquire(timeout=LONG))
            return compile_(signature)

    return compiled


def _folders(function: Any) -> frozenset[Path]:
    """Where what is compiled into a function may lie: beside it, here, and beside what it calls."""
    called = (x.py_func for x in function.__globals__.values() if isinstance(x, Dispatcher))
    beside = (Path(f.__code__.co_filename).parent for f in (function, *called))
    return frozenset((Path(__file__).parent, *beside))


def _keep_apart(kept: Any, folders: frozenset[Path]) -> None:
    """Machine code is kept under the state of all files, and by each process in files of its own.

    Two processes that compile at the same time would otherwise give two things one name.
    """
    kept._source_stamp = (kept._source_stamp, _sources(folders))
    kept._data_name_pattern = kept._data_name_pattern.replace("{", f"{os.getpid()}-{{")


@cache
def _sources(folders: frozenset[Path]) -> str:
    """A hash of all files in folders: what one calls in another is compiled into it, and numba
    asks of a kept function only whether its own file is as it was.
    """
    files = sorted(file for folder in folders for file in folder.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
