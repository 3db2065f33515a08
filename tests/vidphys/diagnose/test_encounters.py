"""Bodies that rush past each other within a few frames: the nodes of a window must follow them."""

import numpy as np
from scipy.integrate import solve_ivp

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.recordings.motion import motion_of

FRAMES, INTERVAL, SOFT, NOISE = 400, 0.02, 0.05, 0.002


def pulled(_: float, state: np.ndarray) -> np.ndarray:
    """Two bodies of unit masses that pull each other by 1 / r², softened."""
    q, v = state.reshape(2, 2, 2)
    apart = q[1] - q[0]
    pull = apart / (apart @ apart + SOFT**2) ** 1.5
    return np.concatenate([v.ravel(), pull, -pull])


def test_a_close_encounter_is_told_without_a_friction_or_a_drive():
    begin = np.array([0.5, 0, -0.5, 0, 0, 0.15, 0, -0.15])
    times = np.arange(FRAMES) * INTERVAL
    path = solve_ivp(pulled, (0, times[-1]), begin, t_eval=times, rtol=1e-10, atol=1e-12).y[:4]
    noise = NOISE * np.random.default_rng(0).standard_normal((FRAMES, 2, 2))
    found = diagnose_motion(motion_of((path.T.reshape(FRAMES, 2, 2) + noise)[None], INTERVAL))
    assert found.kinds == {"pair"}
    fitted = found.inference.fitted
    assert len(fitted.paths.q[0]) > len(found.inference.windows.frames[0])  # nodes, and frames
    np.testing.assert_allclose(fitted.values, [1.0, SOFT], atol=4 * fitted.errors.max())
    assert (np.abs(fitted.values - [1.0, SOFT]) < 4 * fitted.errors).all()
