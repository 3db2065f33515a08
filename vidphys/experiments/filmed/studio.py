"""MuJoCo's renderer as a studio: pieces go in once, their poses and the camera's each frame."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from vidphys.errors import InputError
from vidphys.experiments.filmed.props.pieces import UPRIGHT, Piece, Skin, half_length, pointing
from vidphys.experiments.filmed.textures import TEXTURES

NEAR, FAR = 0.05, 40.0  # metres
SHADOW = 1024  # pixels of the shadow's map
SAMPLES = 4


@dataclass(frozen=True)
class Light:
    """One that throws shadows, and the room's own.

    Args:
        way: that it shines, ``(3,)``.
        strength, ambient: 0..1.
    """

    way: np.ndarray
    strength: float
    ambient: float


class Studio:
    """Draws pieces that stand still and groups that move.

    Args:
        random: of the textures.
        still: pieces at their places.
        groups: by name, about their own origins.
        skins: by name.
        light: see :class:`Light`.
        size: (height, width) of its pictures, pixels.
        focal: pixels.

    Raises:
        InputError: this machine cannot draw.
    """

    def __init__(
        self,
        random: np.random.Generator,
        still: Sequence[Piece],
        groups: Mapping[str, Sequence[Piece]],
        skins: Mapping[str, Skin],
        light: Light,
        size: tuple[int, int],
        focal: float,
    ) -> None:
        self._groups: dict[str, tuple[int, Sequence[Piece]]] = {}
        pieces = list(still)
        for name, group in groups.items():
            self._groups[name] = len(pieces), group
            pieces += group
        used = {name: skins[name] for name in {piece.skin for piece in pieces}}
        pictures = {
            f"{name}.png": _png(TEXTURES[skin.texture](random))
            for name, skin in sorted(used.items())
            if skin.texture
        }
        xml = _document(pieces, used, light, size, focal)
        mujoco = engine()
        self._model = mujoco.MjModel.from_xml_string(xml, pictures)
        self._data = mujoco.MjData(self._model)
        try:
            self._renderer = mujoco.Renderer(self._model, *size)
        except Exception as error:  # its kinds differ with the way in which it draws
            raise InputError(
                f"film: MuJoCo cannot draw here ({error}); on a machine without a screen install "
                "EGL or OSMesa and set MUJOCO_GL=egl or MUJOCO_GL=osmesa"
            ) from error
        mujoco.mj_forward(self._model, self._data)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def pose(self, name: str, place: np.ndarray, axes: np.ndarray = UPRIGHT) -> None:
        """Put a group at a place (metres), turned."""
        first, pieces = self._groups[name]
        for k, piece in enumerate(pieces, first):
            self._data.geom_xpos[k] = place + axes @ piece.place
            self._data.geom_xmat[k] = (axes @ piece.axes).ravel()

    def stretch(self, name: str, corners: np.ndarray) -> None:
        """Lay a group of bars along a line of corners ``(bars + 1, 3)``, metres."""
        first, _ = self._groups[name]
        for k, (a, b) in enumerate(zip(corners[:-1], corners[1:], strict=True), first):
            self._data.geom_xpos[k] = (a + b) / 2
            self._data.geom_xmat[k] = pointing(b - a).ravel()
            self._model.geom_size[k, 1] = half_length(a, b)

    def picture(self, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """RGB bytes ``(H, W, 3)`` as a camera at this pose sees it; its axes are rows."""
        self._data.cam_xpos[0], self._data.cam_xmat[0] = position, axes.T.ravel()
        self._renderer.update_scene(self._data, 0)
        return self._renderer.render().copy()


def engine() -> Any:
    """MuJoCo; where nothing says how it draws, in memory and without a screen."""
    if "DISPLAY" not in os.environ:
        os.environ.setdefault("MUJOCO_GL", "egl")
    # Mesa's software renderer and Triton each bring an LLVM. Torch imports Triton when it likes,
    # and where Mesa's came first, the process dies.
    with suppress(ImportError):
        importlib.import_module("triton._C.libtriton")
    import mujoco

    return mujoco


def _png(picture: np.ndarray) -> bytes:
    from vidphys.data.formats.opencv import opencv

    return opencv().imencode(".png", picture[..., ::-1])[1].tobytes()


def _document(
    pieces: Sequence[Piece],
    skins: Mapping[str, Skin],
    light: Light,
    size: tuple[int, int],
    focal: float,
) -> str:
    height, width = size
    view = np.degrees(2 * np.arctan(height / 2 / focal))
    bright = _say([light.strength] * 3)
    return f"""
<mujoco>
  <statistic extent="1" center="0 0 0"/>
  <visual>
    <global offwidth="{width}" offheight="{height}"/>
    <quality shadowsize="{SHADOW}" offsamples="{SAMPLES}" numslices="20" numstacks="14"/>
    <map znear="{NEAR}" zfar="{FAR}" shadowclip="2.5"/>
    <headlight ambient="{_say([light.ambient] * 3)}" diffuse=".12 .12 .12" specular="0 0 0"/>
  </visual>
  <asset>{"".join(_material(name, skin) for name, skin in sorted(skins.items()))}</asset>
  <worldbody>
    <light type="directional" pos="{_say(-3 * light.way)}" dir="{_say(light.way)}"
      diffuse="{bright}" specular=".3 .3 .3" castshadow="true"/>
    <camera name="phone" fovy="{view:.8f}"/>
    {"".join(_geom(piece) for piece in pieces)}
  </worldbody>
</mujoco>"""


def _material(name: str, skin: Skin) -> str:
    look = f'specular="{skin.shine:.3f}" shininess="0.5"'
    if not skin.texture:
        return f'<material name="{name}" rgba="{_say(skin.colour)} 1" {look}/>'
    if skin.flat:
        texture, spread = 'type="2d"', f'texrepeat="{skin.repeat:.3f} {skin.repeat:.3f}"'
    else:
        texture, spread = 'type="cube" gridsize="1 1"', ""
    return (
        f'<texture name="{name}" {texture} file="{name}.png"/>'
        f'<material name="{name}" texture="{name}" {spread} {look}/>'
    )


def _geom(piece: Piece) -> str:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(piece.axes).as_quat()
    return (
        f'<geom type="{piece.shape}" size="{_say(piece.size)}" material="{piece.skin}" '
        f'pos="{_say(piece.place)}" quat="{_say([w, x, y, z])}" contype="0" conaffinity="0"/>'
    )


def _say(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.7g}" for value in values)
