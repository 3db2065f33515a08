"""The kernel of a network, compiled for cards that are not here."""

import importlib.util
import subprocess
import sys

import pytest

HOPPER = 227 * 1024  # bytes that a program may share on an H100
SMALL = 99 * 1024  # the same on a card of a desk


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="triton is not installed")
@pytest.mark.parametrize(
    ("bodies", "width", "block", "room"),
    [(3, 256, 64, SMALL), (5, 512, 32, HOPPER), (8, 256, 32, HOPPER)],
)
def test_a_block_of_a_network_fits_a_card(bodies, width, block, room):
    """In a process of its own: the tests' type checks and Triton's interpreter stay away."""
    code = f"""
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from dynamics.compiled import cuda

names = cuda._roll.arg_names
pairs = triton.next_power_of_2({bodies} * ({bodies} - 1) // 2)
sizes = dict(RESOLUTION=0, BITS=0, WIDTH={width}, E=max(1, cuda.ROWS[0] // (2 * pairs)),
             N=triton.next_power_of_2({bodies}), P=pairs)
kinds = dict(ones="*i64", others="*i64", asked="*i32", matrix="*fp16", box="fp32", reach="fp32")
kinds |= dict.fromkeys(("start", "mobility", "strength", "parts", "out", "table"), "*fp32")
kinds |= dict.fromkeys(("episodes", "bodies", "pairs", "substeps", "moves", "interval"), "i32")
pointers = [i for i, name in enumerate(names) if "*" in kinds.get(name, "")]
aligned = {{(i,): [["tt.divisibility", 16]] for i in pointers}}
fixed = {{(names.index(k),): v for k, v in (sizes | dict(BLOCK={block})).items()}}
signature = {{name: kinds.get(name, "constexpr") for name in names}}
source = ASTSource(cuda._roll, signature, constexprs=fixed, attrs=aligned)
made = triton.compile(source, target=GPUTarget("cuda", 90, 32), options=cuda.NETWORK)
assert {block} in cuda.BLOCKS and made.metadata.shared <= {room}, made.metadata.shared
"""
    subprocess.run([sys.executable, "-c", code], check=True)
