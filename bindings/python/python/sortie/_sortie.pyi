import os
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Bundle", "Plan", "compile"]

_Path: TypeAlias = str | os.PathLike[str]
# Strictly typed callers read a dict's values by `isinstance`, or name the output that they want.
_Answer: TypeAlias = Any

@final
class Plan:
    """A policy as a plan.

    `source` is the path or the bytes of a plan, or of an ONNX file, which is compiled first by the program that the
    package carries: in a process of its own with limits, while Python's other threads run on.

    `profile` is "exact" (the same bits everywhere) or "fused"; plans of the profile int8 come from the command line. `outputs`, `sizes`, `states` and `available` say
    what the file leaves unclear: `outputs=["actions"]`, `sizes={"N": 7}`, `states=["h_in:h_out"]`,
    `available="mask"` ("none" where nothing is one). They are for ONNX files; a plan has them decided.

    Raises CompileError, PlanError, OSError; ValueError for options that do not fit.
    """

    def __new__(
        cls,
        source: _Path | bytes | bytearray,
        profile: str = "exact",
        *,
        outputs: Sequence[str] = ...,
        sizes: Mapping[str, int] = ...,
        states: Sequence[str] = ...,
        available: str | None = None,
    ) -> Plan: ...
    def __call__(self, *inputs: ArrayLike | Mapping[str, ArrayLike], **named: ArrayLike) -> _Answer:
        """Answers one case: `plan(observation)`, `plan(a, b)`, `plan(a=a, b=b)` or `plan({"a": a, "b": b})`.

        Inputs have the file's shapes, or these without a leading 1; then answers come without one too. A C-contiguous
        float32 array is read where it lies; lists, other floats, whole numbers, flags and arrays with gaps are
        converted to float32 first.

        Returns a new array, or a dict of new arrays by name where several outputs are wanted. Recurrent states are
        kept, see `state`; they change where there was an answer.

        Raises TypeError and ValueError for what does not fit, DecideError for NaN and infinity.
        """

    def decide(
        self,
        *inputs: ArrayLike | Mapping[str, ArrayLike],
        available: ArrayLike | None = None,
        **named: ArrayLike,
    ) -> Any:
        """The action of one case: the index of the largest score among the available actions, the lowest on ties, as
        an int (an array where the output is several choices), or the numbers of a continuous action.

        `available` are flags, 0 = not available. A policy that takes such a mask as an input gets it here.
        """

    def decide_batch(
        self,
        *observations: ArrayLike | Mapping[str, ArrayLike],
        available: ArrayLike | None = None,
        states: NDArray[np.float32] | None = None,
        **named: ArrayLike,
    ) -> NDArray[Any]:
        """The actions of B cases: inputs `[B, ...]`, `available` `[B, U]`, int64 `[B]` or float32 `[B, K]`.

        A recurrent policy needs `states` `[B, R]`, which are replaced where all could be decided; `Plan.state` plays no
        part. Works on copies without Python's lock.
        """

    @property
    def state(self) -> NDArray[np.float32]:
        """A copy of the recurrent states `[R]`, one behind the other as `inspect` lists them; empty if there is none.
        May be assigned."""

    @state.setter
    def state(self, state: ArrayLike) -> None: ...
    def reset(self) -> None:
        """Sets the recurrent states to zero: an episode begins."""

    def inspect(self) -> dict[str, Any]:
        """What the plan takes, gives, computes and costs: `sortie inspect PLAN --json`."""

@final
class Bundle:
    """A team: its agents, and the allocator that it learned.

    The plans that a bundle ships are asked about its golden answers first. Raises BundleError.
    """

    def __new__(cls, folder: _Path) -> Bundle: ...
    def decide(
        self,
        entities: ArrayLike,
        visible: ArrayLike,
        available: ArrayLike,
        last_actions: ArrayLike | None = None,
    ) -> NDArray[np.int64]:
        """The action of every agent `[A]`, -1 where none is available.

        `entities` `[N, d]` are rows of features, the A agents first. `visible` `[A, N]` says who may attend to whom,
        `available` `[A, U]` which actions there are, `last_actions` `[A]` what was done before, -1 for nothing.
        Agents with memory remember by their place.
        """

    def allocate(
        self,
        entities: ArrayLike,
        agents: int,
        entity_tasks: ArrayLike,
        open_tasks: ArrayLike,
        *,
        present: ArrayLike | None = None,
        relation: ArrayLike | None = None,
    ) -> NDArray[np.int64]:
        """The subtask of every agent `[A]`, -1 for none.

        `entity_tasks` `[N, T]` says which entity belongs to which subtask (agents: their last allocation),
        `open_tasks` `[T]` which are to be done, `present` `[N]` what exists, `relation` `[T, N, F]` what the
        environment knows of an entity and a subtask.
        """

    def reset(self) -> None:
        """Agents forget: an episode begins."""

    def inspect(self) -> dict[str, Any]:
        """The content of `bundle.toml`, and the bundle's `id`."""

def compile(
    onnx: _Path | bytes | bytearray,
    out: _Path,
    profile: str = "exact",
    *,
    outputs: Sequence[str] = ...,
    sizes: Mapping[str, int] = ...,
    states: Sequence[str] = ...,
    available: str | None = None,
) -> dict[str, Any]:
    """Compiles a policy's ONNX file and writes its plan: `sortie compile`. Returns what is known of the plan."""
