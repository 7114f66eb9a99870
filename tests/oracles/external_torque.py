"""Writes data/external_torque.in: the arm of the core's unit tests (shared/src/task/impedance/tests/fixture.rs), moved
by torques that are held for 10 ms each while something pushes and twists its tool. Pinocchio's articulated-body
algorithm, Runge–Kutta with 0.1 ms; rotors 0.03 kg·m², viscous friction 0.3 N·m·s. For every tick: angles, torques held
from then on, and the joint torques of the push behind a first-order filter of 30 rad/s, half a period earlier: that is
where the mean of what a period's filter takes in lies, a whole period before its result."""

import numpy as np
import pinocchio as pin

from data_file import write

COLUMNS = """
The arm of seven joints under a push on its tool, a row for each tick of 10 ms.
Rows: angles [rad], torques held from then on [N m], filtered joint torques of the push half a period ago
[N m].
"""

PERIOD, STEPS, TICKS, BANDWIDTH, VISCOUS, ROTOR = 0.01, 100, 120, 30.0, 0.3, 0.03
SHAPES = [
    ((0, -1, 0), 0.0, 0.5), ((-1, 0, 0), 0.0, 0.4), ((0, 0, 1), 0.0, 1.5), ((0, -1, 0), -0.3, 0.9),
    ((0, 0, 1), -0.26, 0.4), ((0, -1, 0), 0.0, 0.2), ((1, 0, 0), 0.0, 0.5),
]
START = np.array([0.9, 0.3, -0.4, 1.2, 0.3, 0.4, -0.2])
SWING = np.array([0.10, -0.08, 0.12, 0.15, -0.20, 0.15, 0.25])

model, parent = pin.Model(), 0
model.gravity = pin.Motion(np.array([0, 0, -9.81, 0, 0, 0]))
for number, (axis, height, mass) in enumerate(SHAPES):
    joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
    parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([0, 0, height])), f"joint{number}")
    inertia = pin.Inertia(mass, np.array([0, 0, -0.1 * mass]), np.diag([1e-3, 1e-3, 5e-4]))
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
tip = model.addFrame(pin.Frame("tip", parent, 0, pin.SE3(np.eye(3), np.array([0, 0, -0.1])), pin.FrameType.OP_FRAME))
model.armature = np.full(7, ROTOR)
data = model.createData()


def wrench(time):
    """Returns the wrench on the tool, in base axes: it rises within 0.2 s, oscillates, and falls within 0.1
    s."""
    on = np.clip((time - 0.5) / 0.2, 0, 1) * np.clip((1.1 - time) / 0.1, 0, 1)
    return on * np.array([8.0, -5.0 * np.cos(9 * time), 6.0, 0.3, 0.4 * np.sin(7 * time), -0.5])


def push(q, time):
    jacobian = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
    return jacobian.T @ wrench(time)


def change(state, torque, time):
    q, v, filtered = state[:7], state[7:14], state[14:]
    external = push(q, time)
    acceleration = pin.aba(model, data, q, v, torque + external - VISCOUS * v)
    return np.concatenate([v, acceleration, BANDWIDTH * (external - filtered)])


state, rows = np.concatenate([START, np.zeros(14)]), []
filtered_before = np.zeros(7)
for tick in range(TICKS):
    time = tick * PERIOD
    q, v = state[:7], state[7:14]
    aim = START + SWING * (1 - np.cos(5 * time))
    rate = SWING * 5 * np.sin(5 * time)
    desired = SWING * 25 * np.cos(5 * time) + 400 * (aim - q) + 40 * (rate - v)
    torque = pin.rnea(model, data, q, v, desired)
    parts = [f"[{', '.join(f'{value:.9e}' for value in values)}]" for values in (q, torque, filtered_before)]
    rows.append(f"({', '.join(parts)}),\n")
    h = PERIOD / STEPS
    for step in range(STEPS):
        t = time + step * h
        a = change(state, torque, t)
        b = change(state + h / 2 * a, torque, t + h / 2)
        c = change(state + h / 2 * b, torque, t + h / 2)
        d = change(state + h * c, torque, t + h)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
        if step == STEPS // 2 - 1:
            filtered_before = state[14:].copy()
write("external_torque.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")
