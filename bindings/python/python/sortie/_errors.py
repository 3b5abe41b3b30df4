"""What can go wrong, in the words of the command line."""

from typing import Any


class SortieError(Exception):
    """Whatever Sortie refuses."""


class PlanError(SortieError):
    """Bytes are no plan that can be loaded, or another network's."""


class CompileError(SortieError):
    """An ONNX file does not become a plan; the message names the option that helps, where one does."""


class BundleError(SortieError):
    """A folder is no bundle, or its parts do not belong together."""


class DecideError(SortieError):
    """A plan that fits was given numbers on which nothing can be decided: NaN, or no available action."""


class ServeError(SortieError):
    """A served policy cannot be asked: there is none, it is another one, another robot's program has it, or shared
    memory cannot be used. `exit_code` is the number by which the command line tells these apart."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class DifferenceError(SortieError):
    """Answers differ from the recorded ones. `report` holds what was compared."""

    def __init__(self, message: str, report: dict[str, Any]) -> None:
        super().__init__(message)
        self.report = report
