"""What is asked of the reference itself: is it sound, and how far ahead can it be known?"""

from __future__ import annotations

from vidphys import metrics
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS
from vidphys.runs.records import Recorder
from vidphys.scenes import certify, lyapunov_time

ROUNDS = 40  # pieces of the Lyapunov time's estimate


def score_truth(recorder: Recorder, question: Question, steps: int = DRIFT_STEPS[-1]) -> None:
    """Certificates of the held-out episodes, and how long an error takes to grow by e (seconds).

    Energy is not asked to hold where the law has friction.

    Args:
        recorder: gets the numbers.
        question: whose scene, starts and laws are checked.
        steps: reference steps that are checked and that the Lyapunov time is estimated over.
    """
    scene, conserving = question.scene, question.scene.conserves
    path = scene.simulate(question.truth, question.params, steps, question.every)
    proof = certify(scene, path, conserving=conserving)
    recorder.add_value("certified_fraction", float(proof.passed.double().mean()))
    recorder.add_value("closest_approach", float(proof.closest.min()))
    if conserving:
        recorder.add("reference_drift_median", metrics.median(proof.drift), None, steps)
        recorder.add("reference_drift_worst", metrics.worst(proof.drift), None, steps)
    time = lyapunov_time(scene, question.truth, question.params, ROUNDS, steps // ROUNDS)
    recorder.add_value("lyapunov_time", float(time.quantile(0.5)))
