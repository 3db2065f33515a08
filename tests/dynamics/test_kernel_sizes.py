"""The kernel of a network, compiled for cards that are not here."""

import pytest

from loops import has_triton
from tests.shared.kernels import apart

HOPPER = 227 * 1024  # bytes that a program may share on an H100
SMALL = 99 * 1024  # the same on a card of a desk


@pytest.mark.skipif(not has_triton(), reason="triton is not installed")
@pytest.mark.parametrize(
    ("bodies", "width", "block", "room"),
    [
        pytest.param(3, 256, 64, SMALL, marks=pytest.mark.slow),
        pytest.param(5, 512, 32, HOPPER, marks=pytest.mark.slow),
        (8, 256, 32, HOPPER),
    ],
)
def test_a_block_of_a_network_fits_a_card(bodies, width, block, room):
    """In a process of its own: the tests' type checks and Triton's interpreter stay away."""
    apart(f"""
import triton
from dynamics.compiled import cuda
from tests.shared.kernels import shared_bytes

pairs = triton.next_power_of_2({bodies} * ({bodies} - 1) // 2)
sizes = dict(RESOLUTION=0, BITS=0, WIDTH={width}, E=max(1, cuda.ROWS[0] // (2 * pairs)),
             N=triton.next_power_of_2({bodies}), P=pairs, BLOCK={block})
kinds = dict(ones="*i64", others="*i64", asked="*i32", matrix="*fp16", box="fp32", reach="fp32")
kinds |= dict.fromkeys(("episodes", "bodies", "pairs", "substeps", "moves", "interval"), "i32")
shared = shared_bytes(cuda._roll, sizes, cuda.NETWORK, kinds)
assert {block} in cuda.BLOCKS and shared <= {room}, shared
""")
