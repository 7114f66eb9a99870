#!/usr/bin/env python3
"""Motions of the three-finger hand from MuJoCo (double precision, Runge-Kutta, steps of 0.05 ms).

MuJoCo reads the same URDF as the simulator, but shares nothing else with it: folding of fixed joints,
dynamics and integration are its own. Torques pass a delay of 0.3 ms and a lag of 300 Hz, integrated exactly,
as in the plant. Every control period of 10 ms the torque is

    torque = feedforward + stiffness * (reference - position)

and each row of the result has feedforward, reference and position at the start of the period, for nine joints.
The script also prints gravity torques and inertias of the hand at the initial posture.
"""

from pathlib import Path

import mujoco
import numpy as np

from data_file import write

COLUMNS = """
Motions: name, gravity [m/s^2], viscous friction [N m s/rad], stiffness [N m/rad], a row for each tick of
10 ms.
Rows, of nine joints: feed-forward torque [N m], reference [rad], position [rad].
"""

HERE = Path(__file__).parent
URDF = HERE / "../../robots/hand3/robot.urdf"
JOINTS = [f"finger{f}_{j}" for f in (1, 2, 3) for j in ("swing", "bend", "curl")]
PERIOD, STEP = 0.01, 5e-5
DELAY, RATE = 0.0003, 2 * np.pi * 300
ROTOR = 2e-4
TILTED = np.array([-6.936718, 0, -6.936718])
START = np.radians([0, 19, 39, 0, 19, 39, 0, 19, 49])
SIGNS = np.array([1, 1, 1, -1, -1, 1, -1, -1, 1])

# name, gravity, viscous friction, stiffness, amplitude [rad], duration of the motion [s]
CASES = [
    ("free", np.zeros(3), 0.0, 0.0, 0.3, 1.0),
    ("servo", TILTED, 0.002, 0.3, 0.3, 1.0),
    ("fast", TILTED, 0.002, 0.3, 0.8, 0.4),
]


def load(gravity, viscous):
    model = mujoco.MjModel.from_xml_path(str(URDF.resolve()))
    names = [model.joint(j).name for j in range(model.njnt)]
    assert names == JOINTS, names
    model.opt.gravity[:] = gravity
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.jnt_limited[:] = 0
    model.dof_frictionloss[:] = 0
    model.dof_damping[:] = viscous
    model.dof_armature[:] = ROTOR
    return model, mujoco.MjData(model)


def minimum_jerk(t, duration):
    s = np.clip(t / duration, 0, 1)
    return (
        10 * s**3 - 15 * s**4 + 6 * s**5,
        (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
    )


def reference(case, t):
    q, v, a = minimum_jerk(t, case[5])
    way = case[4] * SIGNS
    return START + way * q, way * v, way * a


def feedforward(model, data, case, t):
    data.qpos[:], data.qvel[:], data.qacc[:] = reference(case, t)
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def run(case):
    model, data = load(case[1], case[2])
    scratch = mujoco.MjData(model)
    data.qpos[:] = START
    output = target = None
    rows = []
    for tick in range(round(1.2 * case[5] / PERIOD)):
        t = tick * PERIOD
        # Torques for the middle of the period, held over the period.
        forward = feedforward(model, scratch, case, t + PERIOD / 2)
        forward = forward.astype(np.float32).astype(float)
        desired = reference(case, t)[0]
        rows.append((forward, desired, data.qpos.copy()))
        command = forward + case[3] * (desired - data.qpos)
        if output is None:
            # From rest: the drives start without torque.
            output, target = np.zeros(9), np.zeros(9)
        for k in range(round(PERIOD / STEP)):
            goal = command if k * STEP > DELAY - STEP / 2 else target
            end = goal + (output - goal) * np.exp(-RATE * STEP)
            data.qfrc_applied[:] = goal + (output - end) / (RATE * STEP)
            output = end
            mujoco.mj_step(model, data)
        target = command
    return rows


def literal(vector):
    return "[" + ", ".join(repr(round(float(x), 10)) for x in vector) + "]"


def main():
    text = "&[\n"
    for case in CASES:
        rows = run(case)
        text += f'    ("{case[0]}", {literal(case[1])}, {case[2]!r}, {case[3]!r}, &[\n'
        text += "".join(f"        ({', '.join(map(literal, row))}),\n" for row in rows)
        text += "    ]),\n"
        error = max(abs(row[1] - row[2]).max() for row in rows)
        print(f"{case[0]}: {len(rows)} periods, furthest from the reference {1e3 * error:.1f} mrad")
    write("plant_motion.in", __file__, COLUMNS, text + "]\n")

    model, data = load(TILTED, 0.002)
    data.qpos[:] = START
    mujoco.mj_forward(model, data)
    mass = np.zeros((9, 9))
    mujoco.mj_fullM(model, data, mass)
    for name, torque, inertia in zip(JOINTS, data.qfrc_bias, np.diag(mass)):
        print(f"{name}: holding torque {1e3 * torque:7.2f} mN m, inertia with rotor {inertia:.3e} kg m2")


if __name__ == "__main__":
    main()
