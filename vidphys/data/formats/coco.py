"""COCO's boxes as tracks: the centre of each, a body for each track, or else for each category."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import reading, require_room
from vidphys.errors import InputError

TRACKS = ("track_id", "instance_id")
FRAMES = ("frame_id", "frame_index", "frame")


def is_coco(held: Any) -> bool:
    """Whether a JSON value is of this kind."""
    return isinstance(held, dict) and all(
        isinstance(held.get(name), list) for name in ("images", "annotations")
    )


def boxes_of(
    held: Mapping[str, Any], columns: Mapping[str, str], interval: float | None
) -> Recording:
    """The boxes of one clip, whose frames are the images; unseen where an image has none.

    Args:
        held: the JSON.
        columns: ``body=NAME`` takes one track or category.
        interval: seconds between frames.

    Raises:
        InputError: no such boxes, those of several clips, or two of a body in one image.
    """
    with reading("COCO's boxes"):
        return _boxes(held, columns, interval)


def _boxes(
    held: Mapping[str, Any], columns: Mapping[str, str], interval: float | None
) -> Recording:
    images, boxes = held["images"], held["annotations"]
    clips = {image.get("video_id") for image in images}
    if len(clips) > 1:
        raise InputError(f"boxes of {len(clips)} clips (video_id); write a file for each clip")
    numbers, said = _numbered(images)
    row = {image["id"]: at for image, at in zip(images, numbers.argsort().argsort(), strict=True)}
    key = next((k for k in TRACKS if boxes and all(k in box for box in boxes)), "category_id")
    called = {each["id"]: str(each["name"]) for each in held.get("categories", ())}
    names = [_name(box[key], key, called) for box in boxes]
    bodies = _wanted(sorted(set(names), key=_in_order), columns)
    require_room((len(images), len(bodies), 2), 8, "images by bodies")
    places = np.full((len(images), len(bodies), 2), np.nan)
    for box, name in zip(boxes, names, strict=True):
        if name not in bodies:
            continue
        x, y, width, height = map(float, box["bbox"])
        at = row[box["image_id"]], bodies.index(name)
        if np.isfinite(places[at]).all():
            raise InputError(
                f"image {box['image_id']} has two boxes of {name}; give each body a track_id"
            )
        # its pixels are counted from the picture's edge, ours from the first one's centre
        places[at] = x + width / 2 - 0.5, y + height / 2 - 0.5
    numbers = np.sort(numbers)
    times = None if interval is None else (numbers * interval)[None]
    by = "category" if key == "category_id" else "track"
    note = f"centres of COCO's boxes, pixels; bodies by {by}: {', '.join(bodies)}; {said}"
    return Recording(places[None], times, "pixels", notes=(note,), length="px", frames=numbers)


def _numbered(images: Sequence[Mapping[str, Any]]) -> tuple[np.ndarray, str]:
    """Number of the frame that each image is, and how it was told."""
    key = next((k for k in FRAMES if all(k in image for image in images)), None)
    if key is not None:
        found = [int(image[key]) for image in images]
        said = f"frames by {key}"
    else:
        ends = [re.search(r"(\d+)\D*$", str(image.get("file_name", ""))) for image in images]
        found = [int(end[1]) for end in ends if end is not None]
        said = "frames by the names of images"
    if len(set(found)) < len(images) or not images:
        found, said = [int(image["id"]) for image in images], "frames by the ids of images"
        found = np.argsort(np.argsort(found)).tolist()
    if not images:
        raise InputError("no images")
    return np.array(found), said


def _name(value: Any, key: str, called: Mapping[Any, str]) -> str:
    return called.get(value, str(value)) if key == "category_id" else str(value)


def _in_order(name: str) -> tuple[int, str]:
    return (int(name), "") if name.isdecimal() and len(name) < 20 else (2**63, name)


def _wanted(every: list[str], columns: Mapping[str, str]) -> list[str]:
    if not every:
        raise InputError("no boxes")
    if not columns:
        return every
    if set(columns) != {"body"} or columns["body"] not in every:
        raise InputError(
            f"`columns`: COCO's boxes are of {', '.join(every)}; take one with `columns` body=NAME"
        )
    return [columns["body"]]
