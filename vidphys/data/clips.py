"""Rendered clips: a scene simulated, certified, drawn and rounded to bytes like real video."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from dynamics import Parameters, PhaseState, Rollout
from renderers import World
from vidphys.errors import InputError
from vidphys.placement import CPU
from vidphys.scenes import Scene, certify
from vidphys.seeding import derive

MAX_DRAWS = 20
AT_ONCE = 4  # clips drawn at once: larger pictures are fresh memory, four times as slow


@dataclass(frozen=True)
class Clips:
    """A batch of clips with the truth that they were drawn from.

    Args:
        frames: bytes, ``(b, t, c, H, W)``.
        states: true states at the frames, ``(b, t, n, d)``, float64.
        params: the law of each episode.
        interval: seconds between frames.
        world: how the frames were drawn.
        rejected: episodes that failed their certificate (a body left the frame, say).
    """

    frames: Tensor
    states: PhaseState
    params: Parameters
    interval: float
    world: World
    rejected: int

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def times(self) -> Tensor:
        """Seconds of each frame since the first, ``(t,)``, float64."""
        return torch.arange(self.frames.shape[1], dtype=torch.float64) * self.interval

    def images(
        self, index: Tensor | slice = slice(None), device: torch.device | str = CPU
    ) -> Tensor:
        """Frames of some clips as float32 in [0, 1], ``(b, t, c, H, W)``, on a device."""
        return self.frames[index].to(device).float() / 255

    def first(self, count: int) -> Clips:
        """The first ``count`` clips, or all of them."""
        few = slice(0, count)
        return replace(
            self, frames=self.frames[few], states=self.states[few], params=self.params[few]
        )

    def until(self, frame: int) -> Clips:
        """The same clips cut before frame number ``frame``."""
        return Clips(
            self.frames[:, :frame],
            self.states[:, :frame],
            self.params,
            self.interval,
            self.world,
            self.rejected,
        )


def render_clips(
    scene: Scene, world: World, episodes: int, frames: int, stride: int, seed: int, name: str
) -> Clips:
    """Draw ``episodes`` clips of ``frames`` frames, ``stride`` reference steps apart.

    Episodes whose certificate fails are replaced by fresh ones and counted.

    Args:
        scene: law and generator.
        world: renderer; its camera's extent is where all bodies must stay.
        seed, name: of the random stream ("train", "test").

    Raises:
        InputError: the scene hardly ever keeps its bodies in the frame.
    """
    rng = Generator().manual_seed(derive(seed, "clips", name))
    kept: list[Rollout] = []
    drawn = found = 0
    with torch.random.fork_rng([]):  # from which a bath draws its noise
        torch.manual_seed(derive(seed, "noise", name))
        while found < episodes:
            if drawn >= MAX_DRAWS * episodes:
                raise InputError(
                    f"render: only {found} of {drawn} episodes of {scene.name} stay in the frame; "
                    "widen the camera or shorten the clip"
                )
            start, params = scene.sample(episodes, rng)
            rolled = scene.simulate(start, params, stride * (frames - 1), stride)
            good = certify(scene, rolled, world.camera.half_extent, scene.conserves).passed
            bad = rolled.first_bad[good]
            kept.append(Rollout(rolled.states[good], params[good], rolled.dt, bad))
            drawn, found = drawn + episodes, found + int(good.sum())
    states = PhaseState(
        torch.cat([r.states.q for r in kept])[:episodes],
        torch.cat([r.states.p for r in kept])[:episodes],
    )
    params = Parameters.cat([r.params for r in kept])[:episodes]
    frames_seen = pictures(world, scene.place(states.q))
    return Clips(frames_seen, states, params, kept[0].dt, world, drawn - found)


def pictures(world: World, q: Tensor) -> Tensor:
    """Frames of bodies at ``q``, ``(b, t, n, d)`` world units, as bytes ``(b, t, c, H, W)``."""
    return torch.cat([_bytes(world(some.float())) for some in q.split(AT_ONCE)])


def _bytes(frames: Tensor) -> Tensor:
    return (frames * 255).round().to(torch.uint8)
