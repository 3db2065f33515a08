"""Workers that share an extraction while they are killed at random: is each clip there once?

``python -m tests.faults.shared FOLDER CLIPS [--encoder dino-tiny] [--workers 4] [--kills 20]``
makes so many clips by name, whose features are a hash where no encoder is named, and prints a line
of JSON for each way to extract them: the bare loop without claims, parts and index; one worker; and
several with kills. Then whether the last two left the same bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sqlite3
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from pathlib import Path

import numpy as np
import torch

from encoders import load_encoder
from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.parts import Part
from encoders.store import FeatureStore
from vidphys.data.frames import held
from vidphys.data.many import Wanted, extract_many
from vidphys.data.shared import Extraction
from vidphys.data.units import Units, write_units
from vidphys.data.video import Video

FRAMES = 2
LEASE = 10.0
Worker = tuple[ForkProcess, Connection]
Way = Callable[[Path, Path], None]
HASHED = "hashed"
TIMES = np.arange(FRAMES) / 10


class Hashed:
    """Features that are the SHA-256 of each frame."""

    identity = EncoderIdentity("hashed", 1, "0" * 64, "none", "1", 4, "float32")
    frames_per_feature = 1
    layers = ("1",)

    def at(self, layer):
        return self

    def encode_layers(self, frames, times, layers, progress=None):
        found = [hashlib.sha256(frame.numpy().tobytes()).digest() for frame in frames[0]]
        values = torch.frombuffer(bytearray(b"".join(found)), dtype=torch.uint8).float()
        values = values.view(1, len(found), 32, 1, 1)
        return {layer: FeatureMap(values, (4.0, 4.0), times) for layer in layers}

    def __call__(self, frames, times, progress=None):
        return self.encode_layers(frames, times, self.layers)["1"]


def opened(path: Path) -> Video:
    """A clip that is only its name."""
    digest = hashlib.sha256(path.name.encode())
    pixels = np.frombuffer(digest.digest() * 3 * FRAMES, np.uint8).reshape(FRAMES, 4, 8, 3)
    return Video(path, digest.hexdigest(), held(pixels), TIMES, np.arange(FRAMES), ())


def wanted_of(encoder: str, store: FeatureStore) -> Wanted:
    torch.set_num_threads(1)
    if encoder == HASHED:
        return Wanted(Hashed(), ("1",), store, "float16")
    loaded = load_encoder(encoder, {})
    return Wanted(loaded, loaded.layers[-1:], store, "float16")


def bare(encoder: str, clips: Path, folder: Path) -> None:
    """The same slices, extracted one after the other into nothing that lasts."""
    wanted, store = wanted_of(encoder, FeatureStore(folder)), FeatureStore(folder)
    folder.mkdir()
    write_units([clips], {}, folder / "units")
    units = Units(folder / "units")
    for number in range(len(units)):
        with Part(store, folder / "part") as part:
            extract_many(
                map(opened, units[number]), replace(wanted, store=part), lambda v, made: None
            )


def worked(encoder: str, clips: Path, folder: Path) -> None:
    store = FeatureStore(folder)
    outcome = Extraction(store, [clips], wanted_of(encoder, store), {}).run(opened, lease=LEASE)
    assert not outcome.failed, outcome.failed[0]


def measured(way: Way, clips: Path, folder: Path, to: Connection) -> None:
    """As a process of its own: what it took."""
    before, began = memory(), time.process_time()
    way(clips, folder)
    seconds = round(time.process_time() - began, 2)
    to.send({"cpu": seconds, "imports_mb": before, "peak_mb": memory()})


def memory() -> int:
    """MiB of this process at most, those of libraries too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) // 2**10


def started(way: Way, clips: Path, folder: Path) -> Worker:
    """A process that has all imported already, so that kills are many."""
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    process = fork.Process(target=measured, args=(way, clips, folder, there))
    process.start()
    there.close()
    return process, here


def told(name: str, workers: Sequence[Worker], began: float, **more: object) -> None:
    found = [said.recv() for _, said in workers]
    for process, _ in workers:
        process.join()
    seconds = round(time.monotonic() - began, 1)
    print(json.dumps({"way": name, "seconds": seconds, "workers": found, **more}), flush=True)


def killed(way: Way, clips: Path, folder: Path, asked: argparse.Namespace, seconds: float) -> None:
    """Workers of which one is killed at a random instant, and replaced, so many times."""
    workers, kills = asked.workers, asked.kills
    rng, began = np.random.default_rng(0), time.monotonic()
    running = [started(way, clips, folder) for _ in range(workers)]
    done = 0
    while done < kills:
        time.sleep(rng.uniform(0, 2 * seconds / kills))
        number = int(rng.integers(workers))
        process = running[number][0]
        if not all(each.is_alive() for each, _ in running):
            break
        process.kill()
        process.join()
        done += 1
        running[number] = started(way, clips, folder)
    told("killed", running, began, kills=done)


def digests(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file() and ".partial" not in path.name)
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def run(asked: argparse.Namespace) -> None:
    folder, clips = asked.folder, asked.folder / "clips"
    if not clips.is_dir():
        clips.mkdir(parents=True)
        for number in range(asked.clips):
            (clips / f"{number:07d}.avi").touch()
    work = partial(worked, asked.encoder)
    for name, way in (("bare", partial(bare, asked.encoder)), ("one", work)):
        began = time.monotonic()
        told(name, [started(way, clips, folder / name)], began)
    killed(work, clips, folder / "many", asked, time.monotonic() - began)
    one, many = digests(folder / "one"), digests(folder / "many")
    (index,) = (folder / "many" / "shards").glob("*.sqlite")
    with sqlite3.connect(index) as database:
        rows, keys = database.execute(
            "SELECT COUNT(*), COUNT(DISTINCT key) FROM entries"
        ).fetchone()
    print(json.dumps({"same bytes": one == many, "files": len(one), "rows": rows, "keys": keys}))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("clips", type=int)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--encoder", default=HASHED)
    run(parser.parse_args())
