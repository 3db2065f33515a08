"""Trained models in forms that roll fast: splines for pair functions, and fused loops."""

from dynamics.compiled.choice import Form, form_of
from dynamics.compiled.head import CompiledHead, compile_head
from dynamics.compiled.spline import PairSpline, PlaneSpline, RadialSpline
from dynamics.head import Report

__all__ = [
    "CompiledHead",
    "Form",
    "PairSpline",
    "PlaneSpline",
    "RadialSpline",
    "Report",
    "compile_head",
    "form_of",
]
