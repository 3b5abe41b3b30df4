"""A plan, tract and onnxruntime beside recorded answers."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from . import _compiler
from ._errors import CompileError, DifferenceError

DIFFERENCE = 1


def verify(
    onnx: str | os.PathLike[str],
    npz: str | os.PathLike[str],
    *,
    outputs: Sequence[str] = (),
    sizes: Mapping[str, int] | None = None,
    states: Sequence[str] = (),
    available: str | None = None,
) -> dict[str, Any]:
    """Compares plan, tract and, where it is installed, onnxruntime with recorded answers: `sortie verify --npz`.

    `npz` holds `in__NAME` for every input and `out__NAME` for every wanted output, cases along the first axis.

    Returns the report. Raises DifferenceError where an answer of the plan differs by more than the rounding of
    float32 accounts for, CompileError where a file cannot be read.
    """
    command = [_compiler.program(), "verify", os.fspath(onnx), "--npz", os.fspath(npz), "--json"]
    command += [f"--output={name}" for name in outputs]
    command += [f"--size={name}={size}" for name, size in (sizes or {}).items()]
    command += [f"--state={state}" for state in states]
    command += [] if available is None else [f"--available={available}"]
    if importlib.util.find_spec("onnxruntime") is not None:
        command.append(f"--python={sys.executable}")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = done.stderr.strip().splitlines()
    message = said[-1].removeprefix("error: ") if said else f"`sortie verify` ended with {done.returncode}"
    if done.returncode not in (0, DIFFERENCE):
        raise CompileError(message)
    report: dict[str, Any] = json.loads(done.stdout)
    if done.returncode == DIFFERENCE:
        raise DifferenceError(message, report)
    return report
