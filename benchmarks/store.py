"""A feature store of many small entries: seconds to open, look up and add, and memory.

Run from a checkout: ``python -m benchmarks.store FOLDER 1000000``. It makes the store where there
is none yet (minutes) and prints medians. Its driver has arrays, for which torch is not imported.
"""

from __future__ import annotations

import hashlib
import json
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from encoders import shards
from encoders.arrays import FeatureArrays, header
from encoders.entry import Origin
from encoders.identity import EncoderIdentity
from encoders.manifests import KEYED, SCHEMA_VERSION, FeatureRequest
from encoders.parts import Part
from encoders.shards import Loose
from encoders.store import FeatureStore
from registry.seal import SEAL

WHO = EncoderIdentity("made", 1, "f" * 64, "none", "1", 32, "float32")
TIMES = np.array([0.0, 0.1])
MADE = FeatureArrays(np.ones((2, 8, 2, 2), np.float16), (16.0, 16.0), TIMES)
TRIES = 200
TOGETHER = 256  # entries of a part that a worker adds


def request(number: int) -> FeatureRequest:
    """Of a clip that is only a number."""
    return FeatureRequest(WHO, f"{number:064x}", (0, 1), (0.0, 0.1), (32, 32))


def entries(count: int) -> Iterator[Loose]:
    """As extraction makes and packs them, all with the same tensors; only the clips differ."""
    data = header(TIMES, "float16", MADE.values.shape[1:]) + TIMES.tobytes() + MADE.values.tobytes()
    about = {"shape": [2, 8, 2, 2], "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    first = request(0)
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "source": "clip.mp4",
        "request": first.told,
        "made": {},
        "stride": [16.0, 16.0],
        **about,
    }
    clip = first.source_sha256
    key_text = f"{KEYED}:{json.dumps(first.told, sort_keys=True)}"
    seal_text = json.dumps(manifest, sort_keys=True)
    for number in range(count):
        other = f"{number:064x}"
        key = hashlib.sha256(key_text.replace(clip, other).encode()).hexdigest()
        seal = hashlib.sha256(seal_text.replace(clip, other).encode()).hexdigest()
        asked = {**manifest["request"], "source_sha256": other}
        yield Loose(key, {**manifest, "request": asked, SEAL: seal}, data)


def main(folder: Path, count: int) -> None:
    """Make the store if it is not there, and measure it."""
    if not folder.is_dir():
        begun = time.perf_counter()
        shards.AT_ONCE = 20_000  # extraction commits fewer at a time
        FeatureStore(folder).shards.add(entries(count), lambda key: None)
        print(f"made {count} entries in {time.perf_counter() - begun:.0f} s")
    print(f"memory before: {_memory()} MiB")
    begun = time.perf_counter()
    store = FeatureStore(folder)
    assert store.has(request(count // 2))
    print(f"open, and the first look: {time.perf_counter() - begun:.4f} s")
    looks, reads, adds = [], [], []
    for number in range(TRIES):
        asked, new = request(number * count // TRIES), request(count + number)
        looks.append(_timed(lambda asked=asked: store.has(asked)))
        reads.append(_timed(lambda asked=asked: store.arrays(asked)))
        adds.append(_timed(lambda new=new: store.write(new, "new.mp4", MADE)))
    for what, seconds in (("look up", looks), ("read", reads), ("add", adds)):
        print(f"{what}: {1000 * statistics.median(seconds):.3f} ms")
    begun = time.perf_counter()
    with Part(store, folder / "work") as part:
        for number in range(2 * count, 2 * count + TOGETHER):
            each = request(number)
            with part.begin([each], Origin("new.mp4", (32, 32), TIMES)) as filled:
                filled.add([MADE.values])
        part.commit(Path(tempfile.mkdtemp(dir=folder)), {})
    each_took = (time.perf_counter() - begun) / TOGETHER
    print(f"add, {TOGETHER} at one stroke: {1000 * each_took:.3f} ms each")
    begun = time.perf_counter()
    print(f"packed {store.pack()} in {time.perf_counter() - begun:.2f} s")
    print(f"memory at most: {_memory()} MiB, with torch: {'torch' in sys.modules}")


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 2**10


def _timed(work: object) -> float:
    begun = time.perf_counter()
    assert callable(work)
    work()
    return time.perf_counter() - begun


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
