"""The study's heads by name."""

from __future__ import annotations

from dynamics.terms.heads import Attention, Flow, Graph, Hamiltonian, Residual
from dynamics.terms.kinetic import FreeKinetic, PerBody
from dynamics.terms.potentials import FreePotential, Radial
from dynamics.terms.term import HeadTerm
from registry import Registry

HEADS: Registry[HeadTerm] = Registry("head", "vidphys.heads")
HEADS.register("factored", Hamiltonian())
HEADS.register("factored-radial", Hamiltonian(potentials=(Radial(),)))
HEADS.register("factored-learned-kinetic", Hamiltonian(PerBody()))
HEADS.register("symplectic", Hamiltonian(FreeKinetic(256), (FreePotential(256),)))
HEADS.register("unstructured", Residual())
HEADS.register("neural-ode", Flow())
HEADS.register("gns", Graph())
HEADS.register("factored-gns", Graph(factored=True))
HEADS.register("set-transformer", Attention())
