"""The scenarios of the simulator: run as they are, stepped, or as Gymnasium environments.

Machine and control core are those of ``cargo sim``, in this process: the frames of a run are the same, bit by
bit. A scenario pauses in each control period (10 ms) of an enabled task. There its own command can be
replaced; what it does to the machine (walls, weights, a tool that is released) still happens.

Environments need PyPI's ``gymnasium``: ``pip install tesaki[sim]``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from . import COMMANDS, Robot, SimulationError, robots
from ._tesaki import Run, scenarios

__all__ = ["COMMANDS", "Env", "Result", "Run", "make", "run", "scenarios"]

PERIOD = 0.01
"""The control period [s]."""

_KINDS = {
    "joint servo": "joints",
    "impedance control": "tool",
    "grasping": "object",
    "telexistence": "fingertips",
    "visual approach": "hand",
}
"""The kind of command of an environment in each task, unless its scenario specifies another."""

_OF_SCENARIO = {"hand3-reach": "tips"}


@dataclass(frozen=True)
class Result:
    """The results of a scenario."""

    summary: dict[str, Any]
    """As ``cargo sim run --json`` prints it: metrics with limits, and ``frames_sha256``."""
    tables: dict[str, str] = field(repr=False)
    """What was recorded, one row a control period: CSV by file name."""

    @property
    def frames_sha256(self) -> str:
        """Digest of all answers of the control core: equal digests mean equal bits."""
        return self.summary["frames_sha256"]

    def table(self, name: str) -> np.ndarray:
        """Returns a table as a structured array, with a field per column."""
        from io import StringIO

        return np.genfromtxt(StringIO(self.tables[name]), delimiter=",", names=True)


def _folder(name: str, robot: str | PathLike[str] | None) -> Path:
    if robot is not None:
        return Path(robot)
    found = [scenario["robot"] for scenario in scenarios() if scenario["name"] == name]
    # `Run` reports an unknown scenario, with the known ones.
    return robots() / (found[0] if found else "hand3")


def run(
    scenario: str,
    seed: int = 1,
    *,
    robot: str | PathLike[str] | None = None,
    on_tick: Callable[[dict[str, Any]], None] | None = None,
) -> Result:
    """Runs a scenario as it is, like ``cargo sim run SCENARIO --seed SEED``.

    Args:
        scenario: its name; ``scenarios()`` lists them.
        seed: determines the machine's deviations and noise.
        robot: another robot's folder.
        on_tick: called with the state in each control period of an enabled task, before its tick; see ``Run``.

    Raises:
        SimulationError: why it did not come to its end.
    """
    steps = Run(scenario, _folder(scenario, robot), seed)
    if on_tick is None:
        steps.finish()
    else:
        state = steps.begin()
        while state is not None:
            on_tick(state)
            state = steps.step()
    return _result(steps)


def _result(steps: Run) -> Result:
    told = json.loads(steps.summary())
    return Result(told["summary"], dict(told["tables"]))


def make(scenario: str, **options: Any) -> "Env":
    """Returns the Gymnasium environment of a scenario; see ``Env`` for the options."""
    return Env(scenario, **options)


def _environment():
    try:
        import gymnasium
    except ModuleNotFoundError:
        return None
    return gymnasium


_gymnasium = _environment()


class Env(_gymnasium.Env if _gymnasium else object):
    """A scenario as a Gymnasium environment: one trial per episode, one control period (10 ms) per step.

    An action is a command to the running task, with the values of its kind in ``tesaki.COMMANDS``; the kind is
    ``env.kind``. A tuple ``(kind, values)`` commands another kind, ``("nothing",)`` nothing, and ``None`` leaves the
    scenario its own command of this period, which ``info["scripted"]`` holds: an expert to imitate. A refused command
    changes nothing; its reason is ``info["refused"]``. It is no sign of life either: after ten refused commands in a
    row (the command timeout of the robots of this project) the board is in fault.

    Where an action is angles, the bounds of ``action_space`` are the joints' limits; other actions have none, so
    random ones are refused.

    An observation is a dictionary of float32 arrays, all that the board tells: ``position``, ``velocity``,
    ``reference`` [rad, rad/s], ``torque`` [N·m], each (joints,); ``tip_position`` [m], ``tip_force`` [N],
    ``tip_torque`` [N·m], each (tips, 3); and ``target``: what the scenario last commanded of this kind, 0 before.

    ``info`` has also ``report``, the task's own telemetry; ``truth``, what the plant knows and no sensor tells;
    ``scripted``; ``refused``; ``fault``; ``trial`` and ``tick``.

    The reward is minus the true distance from the scenario's target: of joints the mean [rad], of tips and tool [m],
    of an object from where it was grasped [m]; 0 where there is none. ``reward`` replaces it.

    An episode is terminated by a fault, and truncated at the end of the scenario's trial. The first step of
    an episode is when the task takes its first commands; with ``object``, when the hand holds the object.

    Args:
        scenario: its name.
        robot: another robot's folder.
        kind: the kind of command of the actions; by default the one that suits the scenario's task.
        trial: which of the scenario's trials, from 1. Those before run first, as the scenario requires.
        reward: ``reward(observation, info) -> float``.
    """

    metadata = {"render_modes": []}

    def __init__(
        self,
        scenario: str,
        *,
        robot: str | PathLike[str] | None = None,
        kind: str | None = None,
        trial: int = 1,
        reward: Callable[[dict[str, np.ndarray], dict[str, Any]], float] | None = None,
    ):
        if _gymnasium is None:
            raise ModuleNotFoundError("environments need gymnasium: pip install tesaki[sim]")
        if kind is not None and kind not in COMMANDS:
            raise ValueError(f"kind is {kind!r}: expected one of {', '.join(COMMANDS)}")
        if trial < 1:
            raise ValueError(f"trial is {trial}: trials count from 1")
        self.scenario, self.trial = scenario, trial
        self._folder = _folder(scenario, robot)
        self._reward = reward or self._distance
        self._kind = kind
        # One machine determines the shapes.
        state = self._begin(1)
        self.kind: str = kind or _OF_SCENARIO.get(scenario) or _KINDS[state["task"]]
        self._shape = _shape(self.kind, state)
        self._target, self._is_led = np.zeros(self._shape, np.float32), False
        box = _gymnasium.spaces.Box
        self.action_space = box(*_bounds(self.kind, self._shape, self._folder), dtype=np.float32)
        boxes = {name: box(-np.inf, np.inf, value.shape, np.float32) for name, value in self._observation(state).items()}
        self.observation_space = _gymnasium.spaces.Dict(boxes)
        self._steps, self._why = None, "no episode has begun"

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begins an episode on the machine of ``seed``, or on a random machine without one."""
        super().reset(seed=seed)
        self._why = "the episode is over"
        machine = seed if seed is not None else int(self.np_random.integers(1, 2**31))
        self._target, self._is_led = np.zeros(self._shape, np.float32), False
        state = self._begin(machine)
        while not self._starts(state):
            state = self._steps.step()
            if state is None or state["is_over"] or state["trial"] != self.trial:
                self._steps = None
                raise SimulationError(f"{self.scenario}, seed {machine}: the trial ended before its first {self.kind}")
        # Where an object was grasped.
        self._origin = (state["truth"] or {}).get("object_position")
        return self._told(state)

    def step(self, action):
        """Advances by one control period."""
        if self._steps is None:
            raise SimulationError(f"{self._why}: reset")
        if action is None:
            state = self._steps.step()
        elif isinstance(action, tuple):
            state = self._steps.step(*action)
        else:
            state = self._steps.step(self.kind, action)
        truncated = state is None or state["is_over"]
        if state is None:
            # The scenario ended without switching its board off.
            state = self._last
        observation, info = self._told(state)
        terminated = info["fault"] is not None
        if truncated:
            self._steps = None
        return observation, float(self._reward(observation, info)), terminated, truncated and not terminated, info

    def close(self):
        """Ends the episode."""
        self._steps = None

    def _begin(self, seed: int) -> dict[str, Any]:
        """Returns the first state of the trial."""
        self._steps = None
        self._steps = Run(self.scenario, self._folder, seed)
        state = self._steps.begin()
        trials = 0
        while state is not None and state["trial"] < self.trial:
            trials = state["trial"]
            state = self._steps.step()
        if state is None:
            if trials == 0:
                raise SimulationError(f"{self.scenario} enables no board that could be commanded: run it")
            raise ValueError(f"trial is {self.trial}, but {self.scenario} has {trials}")
        return state

    def _starts(self, state: dict[str, Any]) -> bool:
        """Returns whether the first step of an episode is here."""
        if self.kind == "object":
            return (state["report"] or {}).get("Grasping", {}).get("phase") == "Hold"
        if self.kind == "tips":
            return state["scripted"] is not None and state["scripted"][0] == "tips"
        return True

    def _observation(self, state: dict[str, Any]) -> dict[str, np.ndarray]:
        names = ["position", "velocity", "reference", "torque", "tip_position", "tip_force", "tip_torque"]
        return {**{name: state[name] for name in names}, "target": self._target.copy()}

    def _told(self, state: dict[str, Any]):
        """Returns observation and info."""
        self._last = state
        scripted = state["scripted"]
        if scripted is not None and scripted[0] == self.kind:
            self._target, self._is_led = np.nan_to_num(scripted[1]), True
        names = ["report", "truth", "scripted", "refused", "fault", "trial", "tick"]
        return self._observation(state), {name: state[name] for name in names}

    def _distance(self, observation: dict[str, np.ndarray], info: dict[str, Any]) -> float:
        """Returns minus the true distance from the target."""
        target, truth = observation["target"], info["truth"]
        if not self._is_led or truth is None:
            return 0.0
        if self.kind in ("joints", "points"):
            goal = target if self.kind == "joints" else target[:, 0]
            return -float(np.abs(truth["position"] - goal).mean())
        if self.kind == "tips":
            return -float(np.linalg.norm(truth["tip_position"] - target[:, :3], axis=1).mean())
        if self.kind in ("tool", "hand"):
            return -float(np.linalg.norm(truth["tip_position"][0] - target[:3]))
        if self.kind == "object":
            return -float(np.linalg.norm(truth["object_position"] - self._origin - target[:3]))
        if self.kind == "fingertips":
            return -float(np.mean((info["report"] or {}).get("Telexistence", {}).get("errors", [0.0])))
        return 0.0


def _bounds(kind: str, shape: tuple[int, ...], folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns the smallest and the largest values of a kind: limits of angles, and else infinite."""
    lower, upper = np.full(shape, -np.inf, np.float32), np.full(shape, np.inf, np.float32)
    if kind in ("joints", "points"):
        limits = Robot(folder).limits
        angles = (...,) if kind == "joints" else (..., 0)
        lower[angles], upper[angles] = limits[:, 0], limits[:, 1]
    return lower, upper


def _shape(kind: str, state: dict[str, Any]) -> tuple[int, ...]:
    """Returns the shape of a kind's values on this robot."""
    joints, tips = len(state["position"]), len(state["tip_position"])
    shapes = {
        "joints": (joints,),
        "points": (joints, 3),
        "tips": (tips, 9),
        "tool": (22,),
        "object": (7,),
        "fingertips": (5, 6),
        "hand": (4,),
    }
    return shapes.get(kind, (0,))
