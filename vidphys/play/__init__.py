"""A model under one's hand: changed in its law, its start or its step, and rolled at once."""

from vidphys.play.asked import Asked
from vidphys.play.rolling import Piece, answers
from vidphys.play.sources import Source, source_of
from vidphys.play.stage import Stage, View
from vidphys.play.surveys import survey

__all__ = ["Asked", "Piece", "Source", "Stage", "View", "answers", "source_of", "survey"]
