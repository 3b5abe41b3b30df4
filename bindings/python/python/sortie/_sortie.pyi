import os
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Action", "Bundle", "Plan", "PolicyClient", "compile"]

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

    @property
    def robot(self) -> dict[str, Any]:
        """What a robot must know of the policy beside the numbers, from the metadata that exporters of Isaac Lab, mjlab
        and RSL-RL write: `joint_names` in the order of actions, `default_joint_pos`, `action_scale`, `stiffness`,
        `damping`, `observation_names`, empty lists where nothing is known. `normaliser` is "file" where the network
        normalises what it sees by itself, "none" where it does not, "unknown" where the plan does not say.
        """

    @property
    def guards(self) -> dict[str, Any] | None:
        """What is let in and out of the policy, by the keys of the file for `sortie compile --guards`; None where the plan
        has no guards. `sortie serve` guards by them, calls of this plan do not. Raises ValueError where they
        may be damaged."""

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
        available: ArrayLike | None = None,
        relation: ArrayLike | None = None,
        proposals: int | None = None,
        seed: int = 0,
    ) -> NDArray[np.int64]:
        """The subtask of every agent `[A]`, -1 for none.

        `entity_tasks` `[N, T]` says which entity belongs to which subtask (agents: their last allocation),
        `open_tasks` `[T]` which are to be done, `present` `[N]` what exists, `available` `[A, U]` which actions there
        are, which an allocator that points has to know, `relation` `[T, N, F]` what the environment knows of an entity
        and a subtask. An allocator that proposes draws `proposals` allocations (1 to 256,
        by default 32; 1 is the most probable one) by noise from `seed`, and takes the one it values most.
        """

    def reset(self) -> None:
        """Agents forget: an episode begins."""

    def inspect(self) -> dict[str, Any]:
        """The content of `bundle.toml`, and the bundle's `id`."""

@final
class PolicyClient:
    """The robot's side of a policy that `sortie serve` runs in another process, under the name `domain`.

    Waits `patience` seconds for a server. `inputs` and `outputs` (lengths by name, in the policy's order) and `actions`
    say what the program gives and wants; a policy of anything else is refused. What is left out fits any policy.

    `deadline` is how many seconds a decision takes at most, `fallback` ("hold", "zero" or an action's number) what is done
    without an answer: both as the server says, unless they are given. `linger` is how many seconds a wait looks for the
    answer before it sleeps. `robot` is what the program knows of its robot, with any of the keys of `Plan.robot`; a policy
    that says something else is refused.

    Python's other threads run on during every wait, and Ctrl-C ends it. One call at a time: a second one raises
    RuntimeError. Not to be used on both sides of a fork.

    Raises ServeError; ValueError for a name that is none, and settings that do not fit.
    """

    def __new__(
        cls,
        domain: str,
        *,
        inputs: dict[str, int] | None = None,
        outputs: dict[str, int] | None = None,
        actions: int | None = None,
        robot: dict[str, Any] | None = None,
        deadline: float | None = None,
        fallback: str | int | None = None,
        patience: float = 10.0,
        linger: float | None = None,
    ) -> PolicyClient: ...
    def decide(
        self,
        *inputs: ArrayLike | Mapping[str, ArrayLike],
        available: ArrayLike | None = None,
        **named: ArrayLike,
    ) -> Action:
        """What to do on these inputs, one after the other, by name or as one dict: at the deadline at the latest, and
        whatever the server does. `available` `[U]` are flags, 0 = not available, of a policy that chooses.

        An input is any array of as many numbers as the policy's, row by row; it is copied.

        Raises TypeError and ValueError for what does not fit; nothing was sent then.
        """

    def begin_episode(self) -> None:
        """The next observation begins an episode: the recurrent state starts anew."""

    def set_deadline(self, deadline: float) -> None:
        """Waits so many seconds for every answer from now on."""

    @property
    def counters(self) -> dict[str, int]:
        """What happened since the start: answered, late and clamped (among these), fallbacks, silent and guarded (among
        these), overdue, foreign, lost_states."""

    @property
    def schema(self) -> dict[str, Any]:
        """What the policy takes and gives: `inputs`, `outputs` and `states`, each with `name` and `length`, and `actions`;
        `robot` as `Plan.robot` has it, where the plan says.
        """

    def close(self) -> None:
        """Leaves the domain, so that another robot may come. At the end of a `with` block by itself."""

    def __enter__(self) -> PolicyClient: ...
    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _raised: BaseException | None,
        _trace: TracebackType | None,
    ) -> None: ...

@final
class Action:
    """What a robot is to do."""

    @property
    def status(self) -> Literal["answered", "late", "fallback"]:
        """Whether it is the policy's, in time or late, or the fallback."""

    @property
    def reason(
        self,
    ) -> Literal["foreign", "length", "non_finite", "no_available_action", "policy", "silence", "guard"] | None:
        """Why it is the fallback; None where it is not."""

    @property
    def guard(
        self,
    ) -> (
        Literal[
            "input_range", "age", "output_not_finite", "output_range", "output_rate", "length", "undecided", "held"
        ]
        | None
    ):
        """The guard of the plan that tripped: for it this is the fallback, or, where `status` is no fallback, outputs were
        brought back to their limits."""

    @property
    def guard_index(self) -> int | None:
        """Which number of all inputs, or of all outputs, the guard is about; None where it is about none."""

    @property
    def action(self) -> int | None:
        """The action that was chosen; None where the policy does not choose, or none is available."""

    @property
    def outputs(self) -> _Answer:
        """The output, float32 `[length]`, or a dict of several by name. New arrays; of a choice they are its scores."""

    @property
    def lost_state(self) -> bool:
        """Whether the server was started anew within the episode, and has forgotten what was before."""

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
