"""What is asked of the reference itself: is it sound, and how far ahead can it be known?"""

from __future__ import annotations

from vidphys import metrics
from vidphys.experiments.scoring import DRIFT_STEPS, Question
from vidphys.records import Recorder
from vidphys.scenes import certify, lyapunov_time

ROUNDS, ROUND_STEPS = 40, 100  # of Lyapunov's exponent: 8 s of a scene with dt = 0.002 s


def score_truth(recorder: Recorder, question: Question, conserving: bool = True) -> None:
    """Certificates of the held-out episodes over the longest horizon, and their Lyapunov time.

    Args:
        recorder: gets the numbers.
        question: whose scene, starts and laws are checked.
        conserving: whether the scene's energy is meant to hold.
    """
    scene, steps = question.scene, DRIFT_STEPS[-1]
    path = scene.simulate(question.truth, question.params, steps, question.every)
    proof = certify(scene, path, conserving=conserving)
    recorder.add_value("certified_fraction", float(proof.passed.double().mean()))
    if conserving:
        recorder.add("reference_drift_median", metrics.median(proof.drift), None, steps)
        recorder.add("reference_drift_worst", metrics.worst(proof.drift), None, steps)
    recorder.add_value("closest_approach", float(proof.closest.min()))
    time = lyapunov_time(scene, question.truth, question.params, ROUNDS, ROUND_STEPS)
    recorder.add_value("lyapunov_time", float(time.median()))
