"""Compile a learned pair law into a spline, and roll 64 episodes of 2,000 steps."""

import time

import torch

import vidphys
from dynamics.compiled.head import compile_head

scene = vidphys.gravity()
head = vidphys.build(vidphys.HEADS["factored"], bodies=3, dt=scene.dt)
start, law = (x.map(torch.Tensor.float) for x in scene.sample(64, torch.Generator().manual_seed(0)))
fast = compile_head(head, tolerance=1e-3)
for name, model in (("as it is", head), ("compiled", fast)):
    vidphys.rollout(model, start, law, 2, scene.dt)  # the first call compiles
    began = time.perf_counter()
    found = vidphys.rollout(model, start, law, 2000, scene.dt)
    print(f"{name}: {time.perf_counter() - began:.2f} s, finite: {bool(found.finite.all())}")
