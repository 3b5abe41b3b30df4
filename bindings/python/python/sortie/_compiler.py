"""The program that reads ONNX files, and where it lies."""

from pathlib import Path

from ._errors import CompileError

PROGRAM = Path(__file__).parent / "bin" / "sortie-tools"


def program() -> str:
    """Its path.

    ONNX files are read by a process of their own, whose memory and time are limited: a damaged one ends that.
    """
    if not PROGRAM.is_file():
        raise CompileError(
            f"`{PROGRAM}` is missing, which reads ONNX files: this installation runs plans; make them with "
            "`sortie compile`, or install a wheel that was built with the compiler (docs/guide/python.md)"
        )
    return str(PROGRAM)
