"""``vidphys export``: rollouts and features as other people's tools read them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class ExportConfig:
    """Write predictions or features as Parquet, LeRobotDataset v3 or WebDataset.

    Example: vidphys export runs/rollout --to lerobot --out exported

    Args:
        source: folder of a finished `vidphys rollout` (its track, and what was rolled on), or a
            feature store of `vidphys extract`.
        out: the folder that is made.
        to: parquet (a row for each frame), lerobot (one rate, one shape) or webdataset (tar files,
            a sample for each episode).
    """

    source: Annotated[Path, tyro.conf.Positional]
    out: Path
    to: Literal["parquet", "lerobot", "webdataset"] = "parquet"


def export(config: ExportConfig) -> None:
    """See :class:`ExportConfig`.

    Raises:
        InputError: nothing to write, something lies in the way, or it does not fit the format.
    """
    from vidphys.data import exports

    count = exports.export(config.source, config.out, config.to)
    print(f"{count} episode{'' if count == 1 else 's'} as {config.to}: {config.out}")
