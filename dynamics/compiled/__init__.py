"""Trained models in forms that roll fast: splines for pair functions, and fused loops."""

from dynamics.compiled.build import Report
from dynamics.compiled.head import CompiledHead, compile_head
from dynamics.compiled.spline import PairSpline, PlaneSpline, RadialSpline

__all__ = ["CompiledHead", "PairSpline", "PlaneSpline", "RadialSpline", "Report", "compile_head"]
