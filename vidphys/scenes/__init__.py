"""The systems of the study: each a law, a generator and its float64 truth."""

from vidphys.scenes.gravity import gravity
from vidphys.scenes.lyapunov import lyapunov_time
from vidphys.scenes.scene import Certificate, Scene, certify

__all__ = ["Certificate", "Scene", "certify", "gravity", "lyapunov_time"]
