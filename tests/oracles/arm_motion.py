#!/usr/bin/env python3
"""Motions of the seven-joint arm from MuJoCo (double precision, Runge-Kutta, steps of 0.05 ms).

MuJoCo reads the same URDF as the simulator, but shares nothing else with it. Rotor inertia, viscous and
Coulomb friction are those of robots/arm7. Torques pass a delay of 0.3 ms and a lag of 300 Hz, integrated
exactly, as in the plant. Every control period of 10 ms the torque is

    torque = feedforward + stiffness * (reference - position) + damping * (change of that difference) / 10 ms

with matrices that make the hand a spring of 300 N/m and 30 N s/m about the basic posture. Each row of the result has
feedforward, reference and position at the start of the period, the hand's end, and the force of the wall on it, a mean
over the period before. The motions: a release 3 cm off the reference; the hand following an oscillation of
0.1 m at 0.5 Hz; the shoulder's yaw, and with it the elbow, swinging by 30 degrees in 1 s about a hand at
rest; the hand pressed against walls.
"""

from pathlib import Path

import mujoco
import numpy as np

from data_file import write

COLUMNS = """
Stiffness by rows [N m/rad]; damping by rows [N m s/rad]; motions.
Motions: name, stiffness [N/m] and damping [N s/m] of the wall, a row for each tick of 10 ms.
Rows: feed-forward torques [N m], references [rad], positions [rad], place of the hand's end [m], mean
force of the wall over the period before [N].
"""

HERE = Path(__file__).parent
URDF = HERE / "../../robots/arm7/robot.urdf"
PERIOD, STEP = 0.01, 5e-5
DELAY, RATE = 0.0003, 2 * np.pi * 300
ROTOR = [0.05, 0.05, 0.03, 0.03, 0.01, 0.005, 0.005]
START = np.array([0, 0, 0, np.pi / 2, 0, 0, 0])
YAW, SIX = 2, [0, 1, 3, 4, 5, 6]
WALL_X = 0.37

# name; duration [s]; wall: stiffness [N/m] and damping [N s/m], or None
CASES = [
    ("release", 1.0, None),
    ("follow", 3.0, None),
    ("elbow", 1.5, None),
    ("stiff wall", 1.5, (50_000.0, 300.0)),
    ("soft wall", 1.5, (200.0, 10.0)),
]


def load():
    spec = mujoco.MjSpec.from_file(str(URDF.resolve()))
    spec.body("hand_mount").add_site(name="hand", pos=[0, 0, -0.1])
    model = spec.compile()
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.tolerance, model.opt.iterations = 1e-12, 100
    model.jnt_limited[:] = 0
    model.dof_armature[:] = ROTOR
    model.dof_solref[:] = [4 * STEP, 1]
    model.dof_solimp[:] = [0.999, 0.9999, 1e-3, 0.5, 2]
    assert abs(sum(model.body_mass) - 4.5) < 1e-12 and np.all(model.dof_frictionloss > 0)
    return model, mujoco.MjData(model)


def hand(model, data, q):
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    mujoco.mj_jacSite(model, data, linear, angular, 0)
    return data.site_xpos[0].copy(), data.site_xmat[0].reshape(3, 3).copy(), np.vstack([linear, angular])


def angles(model, data, place, yaw, q):
    """Returns the joint angles that put the hand at a position, oriented as at the start, for a given yaw."""
    q = q.copy()
    q[YAW] = yaw
    turned = hand(model, data, START)[1]
    for _ in range(20):
        at, turn, jacobian = hand(model, data, q)
        off = turned @ turn.T
        error = np.r_[place - at, 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])]
        q[SIX] += np.linalg.solve(jacobian[:, SIX], error)
    assert np.abs(error).max() < 1e-12
    return q


def minimum_jerk(s):
    s = np.clip(s, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s * s)


def reference(name, t):
    """Returns the displacement of the hand along x from its start, and the yaw."""
    if name == "follow":
        # Begins smoothly.
        return 0.1 * np.sin(np.pi * t) * minimum_jerk(t), 0.0
    if name == "elbow":
        return 0.0, np.radians(30) * minimum_jerk(t)
    if name.endswith("wall"):
        return 0.05 * minimum_jerk(t), 0.0
    return 0.0, 0.0


def gains(model, data):
    jacobian = hand(model, data, START)[2]
    spring = np.diag([300, 300, 300, 5, 5, 5])
    damper = np.diag([30, 30, 30, 0.3, 0.3, 0.3])
    # The yaw is held, too.
    own = np.diag([0, 0, 5, 0, 0, 0, 0])
    return jacobian.T @ spring @ jacobian + own, jacobian.T @ damper @ jacobian + 0.1 * own


def run(case, stiffness, damping):
    name, duration, wall = case
    model, data = load()
    scratch = mujoco.MjData(model)
    ticks = round(duration / PERIOD)
    begin = hand(model, scratch, START)[0]
    path, q = [], START
    for half in range(-1, 2 * ticks + 4):
        x, yaw = reference(name, max(half, 0) * PERIOD / 2)
        q = angles(model, scratch, begin + [x, 0, 0], yaw, q)
        path.append(q)
    at = lambda tick: path[2 * tick + 1]
    force = [0.0]

    def press(model, data):
        depth = data.site_xpos[0][0] - WALL_X
        linear = np.zeros((3, 7))
        mujoco.mj_jacSite(model, data, linear, None, 0)
        force[0] = -max(0.0, wall[0] * depth + wall[1] * (linear[0] @ data.qvel)) if depth > 0 else 0.0
        data.qfrc_passive += linear[0] * force[0]

    mujoco.set_mjcb_passive(press if wall else None)
    data.qpos[:] = angles(model, scratch, begin + [0.03, 0, 0], 0, START) if name == "release" else START
    output, target = np.zeros(7), np.zeros(7)
    rows, before, pressed = [], None, 0.0
    for tick in range(ticks):
        # Torques for the middle of the period, held over the period.
        ahead, middle, behind = path[2 * tick + 3], path[2 * tick + 2], path[2 * tick + 1]
        scratch.qpos[:], scratch.qvel[:] = middle, (ahead - behind) / PERIOD
        scratch.qacc[:] = (ahead - 2 * middle + behind) / (PERIOD / 2) ** 2
        mujoco.set_mjcb_passive(None)
        # Not mj_inverse, which treats Coulomb friction as if it had a stiffness.
        mujoco.mj_forward(model, scratch)
        mass = np.zeros((7, 7))
        mujoco.mj_fullM(model, scratch, mass)
        scratch.qacc[:] = (ahead - 2 * middle + behind) / (PERIOD / 2) ** 2
        friction = model.dof_frictionloss * np.tanh(scratch.qvel / 0.05) + model.dof_damping * scratch.qvel
        forward = mass @ scratch.qacc + scratch.qfrc_bias + friction
        forward = forward.astype(np.float32).astype(float)
        mujoco.set_mjcb_passive(press if wall else None)
        error = at(tick) - data.qpos
        rows.append((forward, at(tick), data.qpos.copy(), hand(model, scratch, data.qpos)[0], [pressed]))
        command = forward + stiffness @ error + damping @ (error - (error if before is None else before)) / PERIOD
        before = error
        pressed = 0.0
        for k in range(round(PERIOD / STEP)):
            goal = command if k * STEP > DELAY - STEP / 2 else target
            end = goal + (output - goal) * np.exp(-RATE * STEP)
            data.qfrc_applied[:] = goal + (output - end) / (RATE * STEP)
            output = end
            mujoco.mj_step(model, data)
            pressed += force[0] * STEP / PERIOD
        target = command
    mujoco.set_mjcb_passive(None)
    way = np.array([row[3] for row in rows]) - begin
    print(f"{name}: hand x {1e3 * way[:, 0].min():.2f} to {1e3 * way[:, 0].max():.2f} mm, ends {1e3 * way[-1]} mm; "
          f"wall up to {max(abs(row[4][0]) for row in rows):.2f} N, at the end {rows[-1][4][0]:.3f} N")
    return rows


def literal(vector):
    return "[" + ", ".join(repr(round(float(x), 9)) for x in vector) + "]"


def main():
    model, data = load()
    stiffness, damping = gains(model, data)
    matrix = lambda m: "[" + ", ".join(map(literal, m)) + "]"
    text = f"({matrix(stiffness)}, {matrix(damping)}, &[\n"
    for case in CASES:
        wall = "None" if case[2] is None else f"Some({case[2]!r})"
        rows = run(case, stiffness, damping)
        text += f'    ("{case[0]}", {wall}, &[\n'
        text += "".join(f"        ({', '.join(map(literal, row))}),\n" for row in rows)
        text += "    ]),\n"
    write("arm_motion.in", __file__, COLUMNS, text + "])\n")

    data.qpos[:] = START
    mujoco.mj_forward(model, data)
    mass = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, mass)
    jacobian = hand(model, data, START)[2]
    print("inertias with rotor", np.diag(mass), "holding torques", data.qfrc_bias)
    print("mass at the hand along x, y, z", 1 / np.diag(jacobian @ np.linalg.inv(mass) @ jacobian.T)[:3])
    print("singular values without yaw", np.linalg.svd(jacobian[:, SIX])[1])


if __name__ == "__main__":
    main()
