"""Finds the physics in video of moving bodies, rolls it forward, and asks for another law."""

from importlib.metadata import version
from typing import TYPE_CHECKING

from registry import lazily

if TYPE_CHECKING:
    from dynamics import HEADS as HEADS
    from dynamics import Parameters as Parameters
    from dynamics import PhaseState as PhaseState
    from dynamics import build as build
    from dynamics import rollout as rollout
    from vidphys.diagnose.diagnosis import diagnose_motion as diagnose_motion
    from vidphys.diagnose.recordings.motion import Motion as Motion
    from vidphys.diagnose.recordings.tables import read_tracks as read_tracks
    from vidphys.errors import InputError as InputError
    from vidphys.notebook import load_ipython_extension as load_ipython_extension
    from vidphys.opened import Run as Run
    from vidphys.opened import open_run as open_run
    from vidphys.probing.probe import probe as probe
    from vidphys.queries import query as query
    from vidphys.reading.encoded import encode_video as encode_video
    from vidphys.scenes import SCENES as SCENES
    from vidphys.scenes import gravity as gravity
    from vidphys.training.loop import FitSettings as FitSettings
    from vidphys.training.loop import fit as fit
    from vidphys.training.segments import from_trajectory as from_trajectory
    from vidphys.training.segments import scale_of as scale_of
    from vidphys.training.segments import segment_loss as segment_loss

HOMES = {
    "FitSettings": "vidphys.training.loop",
    "HEADS": "dynamics",
    "InputError": "vidphys.errors",
    "Motion": "vidphys.diagnose.recordings.motion",
    "Parameters": "dynamics",
    "PhaseState": "dynamics",
    "Run": "vidphys.opened",
    "SCENES": "vidphys.scenes",
    "build": "dynamics",
    "diagnose_motion": "vidphys.diagnose.diagnosis",
    "encode_video": "vidphys.reading.encoded",
    "fit": "vidphys.training.loop",
    "from_trajectory": "vidphys.training.segments",
    "gravity": "vidphys.scenes",
    "load_ipython_extension": "vidphys.notebook",
    "open_run": "vidphys.opened",
    "probe": "vidphys.probing.probe",
    "query": "vidphys.queries",
    "read_tracks": "vidphys.diagnose.recordings.tables",
    "rollout": "dynamics",
    "scale_of": "vidphys.training.segments",
    "segment_loss": "vidphys.training.segments",
}
__all__ = ["__version__", *HOMES]
__version__ = version("vidphys")
__getattr__, __dir__ = lazily(__name__, HOMES)
