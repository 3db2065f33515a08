"""The tensors of one entry of a feature store, written as they are made.

It is what safetensors writes of ``times`` and ``values``, byte for byte, with no value held. Values
in eight bits are followed by their scales and means, which are held until then.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from encoders.arrays import as_kept, as_times, fewer_cells, header
from encoders.grid import stride_of
from encoders.manifests import SCHEMA_VERSION, FeatureRequest
from encoders.quantised import EIGHT, quantised
from registry.seal import sealed

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class Origin:
    """What entries are of that are filled together.

    Args:
        source: label of the clip for people (a path).
        size: of the frames in pixels, (height, width).
        times: of the feature frames, seconds.
        made: what else is known of how they were made, for the manifest.
    """

    source: str
    size: tuple[int | float, int | float]
    times: Tensor | np.ndarray
    made: Mapping[str, Any] = field(default_factory=dict)


class EntryFile:
    """A safetensors file of ``times (t,)`` and ``values (t, c, h, w)``, filled piece by piece.

    Args:
        file: empty.
        origin: of the features.
        dtype: of the values, by its name.
        most: cells on a side that maps are pooled to at most; as they are where not given.
    """

    def __init__(self, file: BinaryIO, origin: Origin, dtype: str, most: int | None = None) -> None:
        self.origin, self.times, self.dtype = origin, as_times(origin.times), dtype
        self.most, self.grid = most, tuple[int, ...]()
        self.file, self._hash, self._frames, self._bytes = file, hashlib.sha256(), 0, 0
        self._beside: list[tuple[np.ndarray, np.ndarray]] = []  # scale and mean of each piece
        self._lost = self._whole = 0.0  # squares, of what eight bits lost and of all

    def add(self, piece: Tensor | np.ndarray) -> None:
        """Append ``(f, c, h, w)``.

        Raises:
            ValueError: values that the dtype cannot hold.
        """
        values = self._kept(piece)
        if values is None:
            raise ValueError(
                f"feature store: features of {self.origin.source} are not finite in "
                f"{self.dtype}; use float32"
            )
        if not self.grid:
            self.grid = tuple(values.shape[1:])
            self._put(header(self.times, self.dtype, self.grid))
            self._put(self.times.tobytes())
        self._put(values.tobytes())
        self._frames += len(values)

    def finished(self) -> dict[str, Any]:
        """Write what comes last; what a manifest says of the file, which is whole.

        Raises:
            ValueError: fewer or more feature frames than times.
        """
        if self._frames != len(self.times):
            raise ValueError(
                f"feature store: {self._frames} feature frames of {self.origin.source} came in, "
                f"and {len(self.times)} times"
            )
        for part in zip(*self._beside, strict=True):
            for values in part:
                self._put(values.tobytes())
        error = math.sqrt(self._lost / self._whole) if self._whole else 0.0
        return {
            "shape": [self._frames, *self.grid],
            "bytes": self._bytes,
            "sha256": self._hash.hexdigest(),
            **({"stored_error": float(f"{error:.3g}")} if self.dtype == EIGHT else {}),
        }

    def _kept(self, piece: Tensor | np.ndarray) -> np.ndarray | None:
        """The values of a piece as they are written."""
        if self.most is None and self.dtype != EIGHT:
            return as_kept(piece, self.dtype)
        whole = as_kept(piece, "float32")
        if whole is None:
            return None
        if self.most is not None:
            whole = fewer_cells(whole, self.most)
        return self._in_eight_bits(whole) if self.dtype == EIGHT else as_kept(whole, self.dtype)

    def _in_eight_bits(self, whole: np.ndarray) -> np.ndarray:
        kept = quantised(whole)
        self._beside.append((kept.scale, kept.mean))
        self._lost += _square(kept.numbers() - whole)
        self._whole += _square(whole)
        return kept.values

    def _put(self, data: bytes) -> None:
        self._hash.update(data)
        self._bytes += self.file.write(data)


def manifest_of(request: FeatureRequest, file: EntryFile) -> dict[str, Any]:
    """What a store says of an entry; see :meth:`encoders.FeatureStore.begin`."""
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "source": file.origin.source,
        "request": request.told,
        "made": dict(file.origin.made),
        "stride": list(stride_of(file.origin.size, file.grid)),
        **file.finished(),
    }
    return sealed(manifest)


def _square(values: np.ndarray) -> float:
    return float(np.square(values, dtype=np.float64).sum())


class Entries:
    """Entries of several layers that are filled together: whole, or not there.

    Args:
        files: their tensors.
        keep: makes entries of the files; only called where all went well.
        drop: leaves nothing else behind; always called, last.
    """

    def __init__(
        self, files: Sequence[EntryFile], keep: Callable[[], None], drop: Callable[[], None]
    ) -> None:
        self._files, self._keep, self._drop = files, keep, drop

    def add(self, piece: Sequence[Tensor | np.ndarray]) -> None:
        """Append features ``(f, c, h, w)`` of each layer.

        Raises:
            ValueError: values that the dtype cannot hold.
        """
        for file, values in zip(self._files, piece, strict=True):
            file.add(values)

    def __enter__(self) -> Entries:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._keep()
        finally:
            self._drop()
