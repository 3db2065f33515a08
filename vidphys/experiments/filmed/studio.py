"""MuJoCo's renderer as a studio: the still room is drawn once, then only where something moves."""

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
AWAY = 1e3  # metres, where what moves is put while the room is drawn
RIM = 6  # pixels around what moves, for the soft edge of its shadow


@dataclass(frozen=True)
class Light:
    """One that throws shadows, and the room's own.

    Args:
        way: that it shines, ``(3,)``.
        strength, ambient: 0..1.
        centre: metres, ``(3,)``; shadows are thrown up to ``reach`` metres from it.
    """

    way: np.ndarray
    strength: float
    ambient: float
    centre: np.ndarray
    reach: float


class Studio:
    """Draws pieces that stand still and groups that move, for a camera that stands.

    Args:
        random: of the textures.
        still: pieces at their places.
        groups: by name, about their own origins.
        skins: by name.
        light: see :class:`Light`.
        size: (height, width) of its pictures, pixels.
        focal: pixels.
        camera: its position and its axes, which are rows.
        walls: planes ``(normal, offset)`` that shadows fall on at the latest.

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
        camera: tuple[np.ndarray, np.ndarray],
        walls: Sequence[tuple[np.ndarray, float]],
    ) -> None:
        self._size, self._focal, self._camera = size, focal, camera
        self._light, self._walls, self._moving = light, walls, len(still)
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
        xml = _document(pieces, used, light, size)
        mujoco = engine()
        self._model = mujoco.MjModel.from_xml_string(xml, pictures)
        self._data = mujoco.MjData(self._model)
        try:
            self._window = mujoco.GLContext(size[1], size[0])
            self._window.make_current()
            self._drawing = mujoco.MjrContext(
                self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value
            )
        except Exception as error:  # its kinds differ with the way in which it draws
            raise InputError(
                f"film: MuJoCo cannot draw here ({error}); on a machine without a screen install "
                "EGL or OSMesa and set MUJOCO_GL=egl or MUJOCO_GL=osmesa"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        mujoco.mj_forward(self._model, self._data)
        self._scene = mujoco.MjvScene(self._model, maxgeom=len(pieces) + 100)
        self._options, self._view = mujoco.MjvOption(), mujoco.MjvCamera()
        self._data.geom_xpos[self._moving :] = AWAY
        self._room = self._draw(0, 0, *size)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._drawing.free()
        self._window.free()

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

    def picture(self) -> np.ndarray:
        """RGB bytes ``(H, W, 3)`` of the room with the groups as they are posed."""
        picture = self._room.copy()
        top, left, bottom, right = self._stir()
        if top < bottom and left < right:
            drawn = self._draw(top, left, bottom, right)
            picture[top:bottom, left:right] = drawn
        return picture

    def _stir(self) -> tuple[int, int, int, int]:
        """Rows and columns of all that moves, and of the way that its shadow takes."""
        centres = self._data.geom_xpos[self._moving :]
        radii = np.sqrt((self._model.geom_size[self._moving :] ** 2).sum(-1))
        long = self._model.geom_type[self._moving :] == engine().mjtGeom.mjGEOM_CAPSULE.value
        radii += np.where(long, self._model.geom_size[self._moving :, 0], 0.0)
        ends = np.concatenate([centres, self._shadows(centres)])
        seen = (ends - self._camera[0]) @ self._camera[1].T
        deep = np.maximum(-seen[:, 2], NEAR)
        middle = np.array(self._size[::-1]) / 2
        places = middle + self._focal * seen[:, :2] / deep[:, None] * [1, -1]
        rim = self._focal * np.tile(radii, 2) / deep * 1.5 + RIM
        low = np.floor((places - rim[:, None]).min(0)).astype(int)
        high = np.ceil((places + rim[:, None]).max(0)).astype(int)
        (left, top), (right, bottom) = (
            np.clip(x, 0, self._size[::-1]).tolist() for x in (low, high)
        )
        return top, left, bottom, right

    def _shadows(self, points: np.ndarray) -> np.ndarray:
        """Where the light through points meets the first of the walls, ``(p, 3)``."""
        way = self._light.way
        far = [(offset - points @ normal) / (way @ normal) for normal, offset in self._walls]
        met = np.min([np.where(f > 0, f, np.inf) for f in far], 0)
        return points + np.where(np.isfinite(met), met, 0.0)[:, None] * way

    def _draw(self, top: int, left: int, bottom: int, right: int) -> np.ndarray:
        """Some of the picture's rows and columns, as they stand in the whole."""
        mujoco = engine()
        self._data.cam_xpos[0], self._data.cam_xmat[0] = self._camera[0], self._camera[1].T.ravel()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._view.fixedcamid = 0
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._options,
            None,
            self._view,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self._scene,
        )
        height, width = self._size
        for eye in self._scene.camera:
            scale = eye.frustum_near / self._focal
            eye.frustum_center = ((left + right) / 2 - width / 2) * scale
            eye.frustum_width = (right - left) / 2 * scale
            eye.frustum_top = (height / 2 - top) * scale
            eye.frustum_bottom = (height / 2 - bottom) * scale
        rows = mujoco.MjrRect(0, 0, right - left, bottom - top)
        picture = np.empty((bottom - top, right - left, 3), np.uint8)
        self._window.make_current()
        mujoco.mjr_render(rows, self._scene, self._drawing)
        mujoco.mjr_readPixels(picture, None, rows, self._drawing)
        return picture[::-1]


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
) -> str:
    height, width = size
    bright = _say([light.strength] * 3)
    return f"""
<mujoco>
  <statistic extent="1" center="0 0 0"/>
  <visual>
    <global offwidth="{width}" offheight="{height}"/>
    <quality shadowsize="{SHADOW}" offsamples="{SAMPLES}" numslices="20" numstacks="14"/>
    <map znear="{NEAR}" zfar="{FAR}" shadowclip="{light.reach:.4g}"/>
    <headlight ambient="{_say([light.ambient] * 3)}" diffuse=".12 .12 .12" specular="0 0 0"/>
  </visual>
  <asset>{"".join(_material(name, skin) for name, skin in sorted(skins.items()))}</asset>
  <worldbody>
    <light type="directional" pos="{_say(light.centre - 3 * light.way)}" dir="{_say(light.way)}"
      diffuse="{bright}" specular=".3 .3 .3" castshadow="true"/>
    <camera name="phone"/>
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
