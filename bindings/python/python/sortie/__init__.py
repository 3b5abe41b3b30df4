"""Learned policies and teams as plans.

    plan = sortie.Plan("walking.onnx")
    actions = plan(observation)

Everything else is in docs/guide/python.md.
"""

from ._errors import BundleError, CompileError, DecideError, DifferenceError, PlanError, ServeError, SortieError
from ._sortie import Action, Bundle, Plan, PolicyClient, compile
from ._verify import verify

__all__ = [
    "Action",
    "Bundle",
    "BundleError",
    "CompileError",
    "DecideError",
    "DifferenceError",
    "Plan",
    "PlanError",
    "PolicyClient",
    "ServeError",
    "SortieError",
    "compile",
    "verify",
]
