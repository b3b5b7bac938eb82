"""Proofs about cycles, folds, flips and thresholds in ball arithmetic (docs/proofs.md).

Needs the extra `proofs` (python-flint). Every number here is a ball, a midpoint with a radius: a comparison
that is true holds for every number of the ball. What cannot be shown raises `NotProven`, which says nothing
about the truth; `Disproven` is raised where the contrary holds for certain.

State (gap, gap', q, q', c, s, 1) with c + i s = Gamma exp(i phi), lengths in g/omega**2: every phase, landing
and contact law is linear in it, so that a phase of t rad is the exponential of a matrix times t.
"""
