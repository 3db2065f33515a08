"""What all anonymous rungs see: the fixed detector's answer, and training windows cut from it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from binders import Detections, detect
from binders.detect import DetectorSettings
from dynamics import Parameters
from registry.seal import SEAL, are_sealed, arrays_seal
from renderers import AnonymousWorld
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.perception.blobs import DrawnWorld, measured_world
from vidphys.runs.atomic import write_tensors

CHUNK = 64  # clips detected at once
SCHEMA_VERSION = "2"  # 1 had neither a seal nor its number
REMEMBERED = 4  # sets of clips that a detector knows again


@dataclass(frozen=True)
class Windows:
    """Detections in short windows of the training clips.

    Args:
        detections: ``(m, window, n, 2)``.
        params: ``(m,)`` and ``(m, n)``, float32.
    """

    detections: Detections
    params: Parameters

    def __len__(self) -> int:
        return len(self.detections.positions)

    def __getitem__(self, index: Tensor) -> Windows:
        whole = self.detections
        part = Detections(whole.positions[index], whole.confidence[index], whole.times)
        return Windows(part, self.params[index])


def windows_of(detections: Detections, params: Parameters, window: int) -> Windows:
    """Every window in which all bodies were found in every frame.

    Args:
        detections: of whole clips.
        params: the law of each clip.
        window: frames of each.

    Raises:
        InputError: there is none, because clips are too short or too much is hidden.
    """
    frames = len(detections.times)
    if frames < window:
        raise InputError(
            f"anonymous: clips of {frames} frames; a tracker learns from windows of {window}; "
            "use longer clips"
        )
    positions = detections.positions.unfold(1, window, 1).movedim(-1, 2)
    confidence = detections.confidence.unfold(1, window, 1).movedim(-1, 2)
    whole = (confidence > 0).all((-2, -1))
    if not bool(whole.any()):
        raise InputError(
            f"anonymous: no window of {window} frames shows all bodies in every frame; "
            "render more or longer clips"
        )
    clip = torch.nonzero(whole)[:, 0]
    found = Detections(positions[whole], confidence[whole], detections.times[:window])
    return Windows(found, params[clip].map(lambda x: x.float()))


@dataclass(frozen=True)
class FixedDetector:
    """The detector by which all anonymous rungs see.

    Args:
        settings: of the search.
        world: that it takes frames to be of; their own where not given.
        device: where it looks.
    """

    settings: DetectorSettings = DetectorSettings()
    world: DrawnWorld | None = None
    device: str = "cpu"

    def __call__(self, clips: Clips) -> Detections:
        """What is found in clips.

        Raises:
            InputError: the clips are of another world, or their bodies differ in mass.
        """
        world = self.world or anonymous_world(clips)
        bodies, camera = clips.states.q.shape[2], world.camera
        parts = [
            detect(
                clips.images(slice(at, at + CHUNK), self.device),
                clips.times.float(),
                bodies,
                world.coverage,
                camera.xs(device=self.device),
                camera.ys(device=self.device),
                self.settings,
            )
            for at in range(0, len(clips), CHUNK)
        ]
        positions = torch.cat([part.positions.cpu() for part in parts])
        confidence = torch.cat([part.confidence.cpu() for part in parts])
        return Detections(positions, confidence, clips.times.float())


def known_world(clips: Clips, blobs: bool) -> DrawnWorld:
    """The world that a rung takes clips to be of: their own, or what blobs in them look like.

    Raises:
        InputError: they are of another world than the anonymous one, their bodies differ in mass,
            or too few stand alone to be measured.
    """
    own = anonymous_world(clips)
    return measured_world(clips) if blobs else own


Detector = Callable[[Clips], Detections]


def detections_of(
    clips: Clips, folder: Path | None = None, detector: Detector = FixedDetector()
) -> Detections:
    """A detector's answer, which is kept.

    Args:
        clips: of the anonymous world.
        folder: where it is kept, under a hash of the clips; ``None`` keeps nothing.
        detector: asked where nothing is kept.

    Raises:
        InputError: the clips are of another world, or their bodies differ in mass.
    """
    anonymous_world(clips)
    kept = None if folder is None else folder / f"detections-{_name(clips)}.safetensors"
    if kept is not None and kept.exists():
        stored = _read(kept)
        return Detections(stored["positions"], stored["confidence"], clips.times.float())
    found = detector(clips)
    if kept is not None:
        both = {"positions": found.positions, "confidence": found.confidence}
        about = {"schema_version": SCHEMA_VERSION}
        about[SEAL] = arrays_seal({k: v.numpy() for k, v in both.items()}, about)
        write_tensors(kept, both, about)
    return found


def _read(path: Path) -> dict[str, Tensor]:
    try:
        with safe_open(path, "pt") as file:
            stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            about = dict(file.metadata() or {})
        good = are_sealed({k: v.numpy() for k, v in stored.items()}, about, SCHEMA_VERSION)
    except (OSError, ValueError, TypeError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be read ({error}); delete it and run again") from error
    if not good or not {"positions", "confidence"} <= stored.keys():
        raise InputError(f"{path}: damaged (it does not fit its hash); delete it and run again")
    return stored


def _name(clips: Clips) -> str:
    """By which clips are known again: all that a detector may look at."""
    about = tuple(clips.frames.shape), clips.states.q.shape[2], clips.interval, clips.world
    found = hashlib.sha256(repr(about).encode())
    found.update(clips.frames.numpy().tobytes())
    return found.hexdigest()[:16]


@dataclass(frozen=True)
class Remembering:
    """A detector that does not look again at clips that it saw lately.

    Args:
        detect: finds the bodies of each frame, the same ones each time.
    """

    detect: Detector
    answers: dict[str, Detections] = field(default_factory=dict)

    def __call__(self, clips: Clips) -> Detections:
        name = _name(clips)
        if name not in self.answers:
            if len(self.answers) >= REMEMBERED:
                del self.answers[next(iter(self.answers))]
            self.answers[name] = self.detect(clips)
        found = self.answers[name]
        return Detections(found.positions, found.confidence, clips.times.float())


def anonymous_world(clips: Clips) -> AnonymousWorld:
    """The clips' world.

    Raises:
        InputError: it is another world, or bodies differ in mass.
    """
    world, mass = clips.world, clips.params.mass
    if not isinstance(world, AnonymousWorld):
        raise InputError(
            f"anonymous: finds equal disks, got clips of {type(world).__name__}; "
            "render them in the anonymous world"
        )
    if bool((mass != mass[:, :1]).any()):
        raise InputError(
            "anonymous: nobody can say which of several bodies that look alike is the heavy one; "
            "use a scene of equal masses"
        )
    return world
