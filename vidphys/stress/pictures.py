"""Images of every size, with bodies in, at the edge of and out of the frame, and their reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import torch
from torch import Tensor

from binders.detect import detect
from binders.palette import track_by_palette
from readouts.soft_argmax import soft_argmax
from renderers import AnonymousWorld, Camera, ChannelWorld, RgbWorld, centroids
from renderers.worlds import SOFTNESS
from vidphys.stress.case import REFUSED, SOUND, Case

SIZES = ((1, 1), (1, 8), (8, 8), (17, 23), (64, 64), (63, 128), (512, 512), (4096, 4096))
PLACES: dict[str, list[list[float]]] = {
    "one body": [[0.3, -0.2]],
    "two at one place": [[0.3, -0.2], [0.3, -0.2]],
    "out of frame": [[40.0, 0.0]],
    "very far": [[1e12, -1e12]],
    "no body": [],
}
_case = partial(
    Case, integrator="none", dtype="float32", path="frames", figure="A28", must=(SOUND,)
)
SURE = 0.5  # confidence from which on a position counts as claimed


def sizes() -> Iterator[Case]:
    """A28: light is where it must be, at any size; what does not fit is refused."""
    for height, width in SIZES:
        for place in PLACES:
            if height * width > 1e6 and place != "one body":
                continue
            for system, measure in (
                ("channels", _channels),
                ("colours", _colours),
                ("anonymous", _anonymous),
            ):
                run = partial(measure, height, width, place)
                bound = 1e-3 if system == "channels" else 0.02
                yield _case("image size", system, f"{height} x {width}, {place}", width, run, bound)
    run = partial(_too_large, 2**20)
    yield _case("image size", "channels", "1,048,576 x 1,048,576", 2**20, run, 0.0, must=(REFUSED,))


def _bodies(place: str) -> Tensor:
    return torch.tensor(PLACES[place]).reshape(-1, 2)


def _channels(height: int, width: int, place: str) -> float:
    """Error of the light's centre in world units and of its amount, where the frame resolves it."""
    camera, sigma = Camera(4.0, height, width), 0.25
    q = _bodies(place)
    frames = ChannelWorld(camera, sigma)(q)
    found, mass = centroids(frames, camera)
    if not bool(torch.isfinite(frames).all() and torch.isfinite(found).all()):
        return math.inf
    if not len(q) or float(q.abs().max()) > 5:
        return float(mass.abs().sum())  # nothing is seen, and nothing is claimed
    if camera.units_per_pixel > sigma:  # undersampled: light within [0, 1] is all that is promised
        return float((frames.amax() > 1).sum() + (frames.amin() < 0).sum())
    exact = 2 * math.pi * sigma**2
    error = torch.cat([(found - q).flatten().abs(), (mass / exact - 1).abs()])
    return float(error.max())


def _colours(height: int, width: int, place: str) -> float:
    camera, radius = Camera(4.0, height, width), 0.35
    q = _bodies(place)
    frame = RgbWorld(camera, radius)(q)
    return _covered(frame.sum(0), camera, radius, q, frame)


def _anonymous(height: int, width: int, place: str) -> float:
    camera, radius = Camera(4.0, height, width), 0.6
    q = _bodies(place)
    frame = AnonymousWorld(camera, radius)(q)
    return _covered(frame[0], camera, radius, q, frame)


def _covered(light: Tensor, camera: Camera, radius: float, q: Tensor, frame: Tensor) -> float:
    """Relative error of the lit area of a disk, where the frame resolves its edge."""
    if not bool(torch.isfinite(frame).all()) or float(frame.max()) > 1 or float(frame.min()) < 0:
        return math.inf
    area = float(light.sum()) * camera.units_per_pixel**2
    if not len(q) or float(q.abs().max()) > 5:
        return area
    if camera.units_per_pixel > radius / 3:
        return 0.0
    rim = 2 * radius * SOFTNESS  # the integral of a sigmoid in r^2, and of 1 - (1 - sigmoid)^2
    area_of_one = math.log1p(math.exp(radius**2 / rim))
    doubled = 1 / (1 + math.exp(-(radius**2) / rim)) if len(q) == 2 else 0.0
    return abs(area / (math.pi * rim * (area_of_one + doubled)) - 1)


def _too_large(side: int) -> float:
    ChannelWorld(Camera(4.0, side, side))(torch.zeros(1, 2))
    return math.inf


# --- reading what there is to read, or nothing ---------------------------------------------------

CONTENT: dict[str, Callable[[tuple[int, ...]], Tensor]] = {
    "black": torch.zeros,
    "saturated": torch.ones,
    "grey": lambda shape: torch.full(shape, 0.5),
    "noise": lambda shape: torch.rand(shape, generator=torch.Generator().manual_seed(0)),
}


def readings() -> Iterator[Case]:
    """A29 and A27: frames that show no body are not read as one with confidence."""
    for side in (1, 8, 32):
        for content in CONTENT:
            for count in (0, 1, 2):
                run = partial(_detected, side, content, count)
                extreme = f"{side} x {side} {content}, {count} bodies asked for"
                yield _case("reading", "detector", extreme, side, run, SURE, figure="A29")
            run = partial(_heat, side, content)
            extreme = f"{side} x {side} {content}"
            if side > 1:  # a map of one cell is pointed and flat at once
                yield _case("reading", "soft-argmax", extreme, side, run, SURE, figure="A29")
            run = partial(_palette, side, content)
            yield _case("reading", "palette", extreme, side, run, SURE, figure="A29")
            run = partial(_centroid, side, content)
            yield _case("reading", "centroid", extreme, side, run, SURE, figure="A29")
    run = partial(_palette, 8, "black", ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    yield _case("reading", "palette", "identical colours", 8, run, 0, must=(REFUSED,), figure="A27")
    run = partial(_one_frame, 32)
    yield _case("reading", "detector", "one frame, one body", 32, run, 0.02, figure="A29")


def _grid(side: int) -> tuple[Tensor, Tensor]:
    camera = Camera(4.0, side, side)
    return camera.xs(), camera.ys()


def _detected(side: int, content: str, count: int) -> float:
    """The largest confidence in a body that is not there."""
    frames = CONTENT[content]((1, 3, 1, side, side))
    xs, ys = _grid(side)
    found = detect(frames, torch.arange(3.0), count, AnonymousWorld().coverage, xs, ys)
    if not bool(torch.isfinite(found.positions).all() and torch.isfinite(found.confidence).all()):
        return math.inf
    return float(found.confidence.max()) if count else 0.0


def _one_frame(side: int) -> float:
    camera = Camera(4.0, side, side)
    q = torch.tensor([[[[0.7, -1.1]]]])
    frames = AnonymousWorld(camera)(q)
    xs, ys = _grid(side)
    found = detect(frames, torch.zeros(1), 1, AnonymousWorld().coverage, xs, ys)
    return float((found.positions - q).abs().max())


def _heat(side: int, content: str) -> float:
    camera = Camera(1.0, side, side)
    centres = torch.stack(torch.meshgrid(camera.ys(), camera.xs(), indexing="ij")[::-1], -1)
    position, confidence = soft_argmax(CONTENT[content]((1, side, side)), centres)
    return float(confidence.max()) if bool(torch.isfinite(position).all()) else math.inf


def _palette(
    side: int, content: str, palette: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0),)
) -> float:
    """The largest share of its light that a body which is not there is said to show."""
    frames = CONTENT[content]((1, 3, 3, side, side))
    xs, ys = _grid(side)
    tracks = track_by_palette(frames, torch.arange(3.0), palette, _disk, xs, ys)
    if not bool(torch.isfinite(tracks.positions).all()):
        return math.inf
    return float(tracks.confidence.max())


def _disk(squared: Tensor) -> Tensor:
    """A disk of the coloured world."""
    return AnonymousWorld(radius=0.35).coverage(squared)


def _centroid(side: int, content: str) -> float:
    """Whether light over the whole frame, or none, is taken for a body's: by its amount."""
    camera = Camera(4.0, side, side)
    position, mass = centroids(CONTENT[content]((1, side, side)), camera)
    body = 2 * math.pi * 0.25**2
    return float(0.5 < float(mass) / body < 2) if bool(torch.isfinite(position).all()) else math.inf
