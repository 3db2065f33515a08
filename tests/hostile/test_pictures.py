"""Z9: a picture that is small in a file and large in memory; a law in which nothing is learned."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from dynamics import terms
from vidphys.cli import main
from vidphys.diagnose.explanations.specification import as_specification

MASKED = """
import resource, sys
from pathlib import Path
from vidphys.cli.who import _mask
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    print(_mask(Path(sys.argv[1])).shape)
except Exception as error:
    print(type(error).__name__, error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def png(path: Path, side: int) -> Path:
    """A black square, a bit for each pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    rows = zlib.compressobj(9)
    packed = b"".join(rows.compress(bytes(1 + -(-side // 8))) for _ in range(side)) + rows.flush()
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
    return path


@pytest.mark.parametrize(("side", "said"), [(64, "(64, 64)"), (30_000, "no picture that can be")])
def test_z09_a_picture_of_too_many_pixels_is_not_read(tmp_path, side, said):
    path = png(tmp_path / "a.png", side)
    done = subprocess.run(
        [sys.executable, "-c", MASKED, str(path)], capture_output=True, text=True, timeout=100
    )
    told, grown = done.stdout.splitlines()
    assert said in told
    assert int(grown) < 200_000


def test_a_law_in_which_nothing_is_learned_is_rolled_as_it_is(tmp_path, capsys):
    t = np.arange(40) / 30
    rows = "\n".join(f"{a:.5f},{1 + 2 * a:.5f},{3 - a:.5f}" for a in t)
    (tmp_path / "t.csv").write_text(f"t,x,y\n{rows}\n")
    free = terms.Hamiltonian(potentials=(terms.NoPotential(),))
    told = as_specification(free, 1, (0.0, 0.0), {}, True, 1 / 30)
    (tmp_path / "s.json").write_text(json.dumps(told))
    words = ["fit", str(tmp_path / "t.csv"), "--specification", str(tmp_path / "s.json")]
    assert main([*words, "--steps", "3", "--out", str(tmp_path / "run")]) == 0
    assert "parameters" in capsys.readouterr().out
