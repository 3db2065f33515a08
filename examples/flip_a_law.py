"""Train a model under attraction, and ask it what happens if the force repels."""

import torch

import vidphys

scene = vidphys.gravity()
start, law = scene.sample(256, torch.Generator().manual_seed(0))
data = vidphys.from_trajectory(scene.simulate(start, law, steps=20), k=1)

head = vidphys.build(vidphys.HEADS["factored"], bodies=3, dt=scene.dt)
loss = vidphys.segment_loss(head, vidphys.scale_of(data))
settings = vidphys.FitSettings(steps=100, batch=256, learning_rate=5e-3)
vidphys.fit(head, loss, data, settings, seed=0)

asked, held = scene.sample(32, torch.Generator().manual_seed(1))
repelling = held.with_coupling(-1.0)
truth = scene.simulate(asked, repelling, steps=150).states.q[:, -1]
single = asked.map(torch.Tensor.float), repelling.map(torch.Tensor.float)
answer = vidphys.rollout(head, *single, 150, scene.dt).states.q[:, -1]
straight = asked.q + 150 * scene.dt * asked.p / held.mass[..., None]

wrong, still = ((x - truth).square().mean() for x in (answer, straight))
print(
    f"error over that of a model without any force: {float(wrong / still):.3f} (below 0.5 counts)"
)
