"""Learned policies and teams as plans.

    plan = sortie.Plan("walking.onnx")
    actions = plan(observation)

Everything else is in docs/python.md.
"""

from ._errors import BundleError, CompileError, DecideError, DifferenceError, PlanError, SortieError
from ._sortie import Bundle, Plan, compile
from ._verify import verify

__all__ = [
    "Bundle",
    "BundleError",
    "CompileError",
    "DecideError",
    "DifferenceError",
    "Plan",
    "PlanError",
    "SortieError",
    "compile",
    "verify",
]
