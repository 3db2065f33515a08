"""Triton's kernels without a card: run in its interpreter, or compiled for a card elsewhere."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def apart(code: str, **environment: str) -> None:
    """Run code in a process of its own, which the tests' type checks stay away from."""
    where = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    subprocess.run([sys.executable, "-c", code], check=True, env=where)


def interpreted(code: str) -> None:
    """Run code where kernels run on the CPU."""
    apart(code, TRITON_INTERPRET="1")


def shared_bytes(
    kernel: Any, sizes: Mapping[str, int], options: Mapping[str, int], kinds: Mapping[str, str]
) -> int:
    """What a program of a kernel shares, compiled for an H100.

    Args:
        sizes: the kernel's constants.
        options: how Triton is to compile it.
        kinds: of its arguments that are no pointers to single precision.
    """
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    names = kernel.arg_names
    fixed = {(names.index(name),): size for name, size in sizes.items()}
    signature = {n: "constexpr" if n in sizes else kinds.get(n, "*fp32") for n in names}
    pointers = [i for i, name in enumerate(names) if "*" in signature[name]]
    aligned = {(i,): [["tt.divisibility", 16]] for i in pointers}
    source = ASTSource(kernel, signature, constexprs=fixed, attrs=aligned)
    made = triton.compile(source, target=GPUTarget("cuda", 90, 32), options=dict(options))
    return int(made.metadata.shared)
