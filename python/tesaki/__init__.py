"""Control core, boards and simulator of robot hands and arms.

- ``Robot``: kinematics and dynamics of a robot folder, for many postures at once, with the control core's own numbers.
- ``least_grip``: the smallest contact forces that hold an object.
- ``Board``: a controller board, real or simulated.
- ``tesaki.sim``: the scenarios of the simulator, also as Gymnasium environments.
- ``tesaki.recordings``: recordings as arrays.

SI units everywhere: m, rad, s, kg, N, N·m. Arrays are float32, as the core computes; only the true
state of a simulated plant and recordings are float64.
"""

from pathlib import Path as _Path

# Loaded now, not by the first array: this takes longer than an enabled board waits for its commander.
import numpy as _numpy  # noqa: F401

from ._tesaki import (
    Board,
    BoardError,
    FaultError,
    FileError,
    RefusedError,
    Robot,
    SimulationError,
    TesakiError,
    __version__,
    least_grip,
)

__all__ = [
    "COMMANDS",
    "Board",
    "BoardError",
    "FaultError",
    "FileError",
    "RefusedError",
    "Robot",
    "SimulationError",
    "TesakiError",
    "__version__",
    "least_grip",
    "robots",
]

COMMANDS = {
    "joints": "(joints,) a goal for each joint, approached through the trajectory filter [rad]",
    "points": "(joints, 3) angle [rad], velocity and acceleration of each joint; one a tick",
    "tips": "(tips, 9) position [m], velocity and acceleration of each fingertip; one a tick",
    "tool": "(22,) position 3 [m], quaternion x, y, z, w, twist 6, its derivative 6, and angle [rad], velocity and "
    "acceleration of the elbow",
    "object": "(7,) translation 3 [m] and rotation vector 3 [rad] of the object since it was grasped, duration [s]",
    "fingertips": "(5, 6) position [m] and velocity [m/s] of a person's fingertips; NaN where unknown",
    "hand": "(4,) position of the hand 3 [m], largest speed [m/s]",
    "put_down": "(0,) lowers the object until it stands, then opens",
    "open_hand": "(0,) opens the hand at once",
    "stand": "(0,) brings the hand of a visual approach to rest",
    "open": "(0,) opens its gripper",
    "close": "(0,) closes its gripper",
    "acknowledge": "(0,) the contact that ended its motion is known",
}
"""The kinds of commands to tasks, with the shape and the meaning of their values.

``joints``, ``points`` and ``tips`` are for the joint servo, ``tool`` for impedance control, ``object``, ``put_down`` and
``open_hand`` for grasping, ``fingertips`` for telexistence, and the others for the visual approach.
"""


def robots() -> _Path:
    """Returns the folder of this package's robots: hand3, arm7, hand5, knob-arm, and third-party hands."""
    return _Path(__file__).resolve().parent / "robots"
