"""Draw three bodies as a camera would see them, and find their places again in the pictures."""

import torch

import vidphys
from renderers import Camera, ChannelWorld, centroids

scene = vidphys.gravity(generator="ring")
start, law = scene.sample(1, torch.Generator().manual_seed(0))
places = scene.simulate(start, law, steps=400).states.q[0, ::40].float()

camera = Camera(half_extent=4.0, height=64, width=64)
frames = ChannelWorld(camera)(places)  # a channel a body
seen, _ = centroids(frames, camera)
print(f"{len(frames)} frames of {tuple(frames.shape[1:])}")
print(f"places are found to {float((seen - places).norm(dim=-1).mean()):.1e} world units")
