#!/usr/bin/env python3
"""Motions of a grasped box from MuJoCo (double precision, steps of 0.02 ms, elliptic friction cones, stiff contacts).

Two rigs, as in host-sim/tests/plant: two hanging bars that squeeze the paper's box between spherical tips (pinch.rs), and
the three-finger hand around it (grip.rs). Torques pass a delay of 0.3 ms and a lag of 300 Hz, integrated exactly, as in the
plant. A push rises, stays and falls. Of the bars each row has the box's position and orientation (x, y, z, w) at the start
of a control period of 10 ms. In the hand

    torque = feedforward + stiffness * (reference - position)

and each row has feedforward, reference, the box's position and orientation, and the joints' positions.
"""

from pathlib import Path

import mujoco
import numpy as np

from data_file import write

PINCH_COLUMNS = """
Motions: name; squeeze [N]; box above the tips [m]; force [N], point [m], begin, ramp and hold [s] of a
push;
a row for each tick of 10 ms.
Rows, of the box: position [m], orientation as quaternion x y z w.
"""
HAND_COLUMNS = """
Stiffness [N m/rad], viscous friction [N m s/rad], a row for each tick of 10 ms.
Rows: feed-forward torques [N m], references [rad], position [m] and orientation of the box as quaternion
x y z w, positions of the joints [rad].
"""

HERE = Path(__file__).parent
URDF = HERE / "../../robots/hand3/robot.urdf"
PERIOD, STEP = 0.01, 2e-5
DELAY, RATE = 0.0003, 2 * np.pi * 300
ROTOR, RADIUS, ARM = 2e-4, 0.008, 0.1
SIZE, MASS, FRICTION = np.array([0.098, 0.208, 0.060]), 0.023, 0.6
INERTIA = MASS / 12 * (np.sum(SIZE**2) - SIZE**2)
CONTACT = f'condim="3" friction="{FRICTION} {FRICTION} 0 0 0" solref="1e-4 1" solimp="0.99 0.999 1e-5"'
OPTION = f'<option timestep="{STEP}" cone="elliptic" impratio="100" tolerance="1e-12" iterations="200" integrator="implicitfast"'

# name, squeeze of each tip [N], box above the tips [m], push [N] at a point of the box [m], its begin, ramp and hold [s],
# duration [s]
PINCH = [
    ("swings", 2.0, -0.015, (0.0, 0.05, 0.0), (0.0, 0.0, -0.03), 0.05, 0.1, 0.1, 1.0),
]
# The hand: middle and pitch of the box, squeeze [N], stiffness [N m/rad], viscous friction [N m s/rad];
# displacement of the box [m], rotation about y [rad] and duration [s].
MIDDLE, PITCH = np.array([0.090, 0.0, 0.085]), 0.769
SQUEEZE, STIFFNESS, VISCOUS = 1.5, 0.6, 0.03
WAY, TURN, DURATION = np.array([0.004, 0.003, 0.004]), 0.1, 0.6
GRAVITY = 6.936718


class Drives:
    """The delay and the lag of the current loops."""

    def __init__(self, joints):
        self.output, self.target = np.zeros(joints), np.zeros(joints)

    def run(self, model, data, command, each=lambda: None):
        for k in range(round(PERIOD / STEP)):
            goal = command if k * STEP > DELAY - STEP / 2 else self.target
            end = goal + (self.output - goal) * np.exp(-RATE * STEP)
            data.qfrc_applied[: len(command)] = goal + (self.output - end) / (RATE * STEP)
            self.output = end
            each()
            mujoco.mj_step(model, data)
        self.target = command


def box(name_tips):
    pairs = "".join(f'<pair geom1="box" geom2="{tip}" {CONTACT}/>' for tip in name_tips)
    inertia = " ".join(map(repr, INERTIA.tolist()))
    body = f"""<freejoint/><inertial pos="0 0 0" mass="{MASS}" diaginertia="{inertia}"/>
      <geom name="box" type="box" size="{SIZE[0]/2} {SIZE[1]/2} {SIZE[2]/2}" contype="0" conaffinity="0"/>"""
    return body, pairs


def push_force(case, t):
    _, _, _, force, _, begin, ramp, hold, _ = case
    s = t - begin
    return np.array(force) * np.clip(min(s, 2 * ramp + hold - s) / ramp, 0, 1)


def pinch(case):
    name, squeeze, above, _, point, _, _, _, duration = case
    x = SIZE[0] / 2 + RADIUS
    bars = "".join(
        f"""<body pos="{side * x} 0 0"><joint type="hinge" axis="0 -1 0" armature="{ROTOR}"/>
        <inertial pos="0 0 -0.05" mass="0.03" diaginertia="2.5e-5 2.5e-5 1e-6"/>
        <body pos="0 0 {-ARM}"><inertial pos="0 0 0" mass="0.005" diaginertia="1.28e-7 1.28e-7 1.28e-7"/>
        <geom name="{tip}" type="sphere" size="{RADIUS}" contype="0" conaffinity="0"/></body></body>"""
        for side, tip in ((-1, "left"), (1, "right"))
    )
    body, pairs = box(("left", "right"))
    xml = f"""<mujoco>{OPTION} gravity="0 0 -9.81"/><worldbody>{bars}
      <body name="box" pos="0 0 {-ARM + above}">{body}</body></worldbody><contact>{pairs}</contact></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    drives, rows, index = Drives(2), [], model.body("box").id

    def push():
        force = push_force(case, data.time)
        # mj_step has not run yet for this state: position and orientation of the free body come from qpos.
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[5:9])
        arm = turn.reshape(3, 3) @ np.array(point)
        data.xfrc_applied[index] = np.concatenate([force, np.cross(arm, force)])

    for _ in range(round(duration / PERIOD)):
        rows.append((data.qpos[2:5].copy(), data.qpos[[6, 7, 8, 5]]))
        drives.run(model, data, ARM * squeeze * np.array([1.0, -1.0]), push)
    way = 1e3 * (rows[-1][0] - rows[0][0])
    print(f"{name}: goes {way} mm, turns {np.degrees(2 * np.arcsin(rows[-1][1][:3]))} deg")
    return rows


def tip(finger, q):
    l1, l2, l3 = 0.039, 0.046, 0.05178
    r = l2 * np.sin(q[1]) + l3 * np.sin(q[1] + q[2])
    z = l1 + l2 * np.cos(q[1]) + l3 * np.cos(q[1] + q[2])
    x, y = r * np.cos(q[0]), r * np.sin(q[0])
    return np.array([x, 0.040 * (1 - 2 * finger) + y, 0.0375 + z]) if finger < 2 else np.array([0.025 + z, -y, 0.020 + x])


def jacobian(finger, q):
    steps = 1e-6 * np.eye(3)
    return np.column_stack([(tip(finger, q + s) - tip(finger, q - s)) / 2e-6 for s in steps])


def angles(finger, place, q=(0.0, 0.4, 1.0)):
    q = np.array(q)
    for _ in range(60):
        q += np.clip(np.linalg.solve(jacobian(finger, q), place - tip(finger, q)), -0.2, 0.2)
    return q


def rotation(pitch):
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def minimum_jerk(s):
    s = np.clip(s, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s * s)


def hand_model():
    spec = mujoco.MjSpec.from_file(str(URDF.resolve()))
    tips = []
    for finger in (1, 2, 3):
        upper = spec.body(f"finger{finger}_upper")
        geom = upper.add_geom(name=f"tip{finger}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=0)
        # Bits that match no other geom: in a URDF, a geom without bits counts as decoration.
        geom.pos, geom.contype, geom.conaffinity = [0, 0, 0.05178], 2, 0
        tips.append(geom.name)
    body = spec.worldbody.add_body(name="box", pos=MIDDLE, quat=[np.cos(PITCH / 2), 0, np.sin(PITCH / 2), 0])
    body.add_freejoint()
    body.mass, body.inertia, body.explicitinertial = MASS, INERTIA, True
    body.ipos, body.iquat = [0, 0, 0], [1, 0, 0, 0]
    body.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=SIZE / 2, contype=2, conaffinity=0)
    for name in tips:
        pair = spec.add_pair(geomname1="box", geomname2=name)
        pair.condim, pair.friction = 3, [FRICTION, FRICTION, 0, 0, 0]
        pair.solref, pair.solimp = [1e-4, 1], [0.99, 0.999, 1e-5, 0.5, 2]
    model = spec.compile()
    model.opt.gravity[:] = [-GRAVITY, 0, -GRAVITY]
    model.opt.timestep, model.opt.cone, model.opt.impratio = STEP, mujoco.mjtCone.mjCONE_ELLIPTIC, 100
    model.opt.tolerance, model.opt.iterations = 1e-12, 200
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.jnt_limited[:] = 0
    model.dof_frictionloss[:] = 0
    model.dof_damping[:9] = VISCOUS
    model.dof_armature[:9] = ROTOR
    assert abs(model.body("box").mass[0] - MASS) < 1e-12
    assert np.all(model.body("box").ipos == 0)
    assert np.allclose(np.sort(model.body("box").inertia), np.sort(INERTIA))
    return model


def hand():
    model = hand_model()
    data, scratch = mujoco.MjData(model), mujoco.MjData(model)
    out = SIZE[0] / 2 + RADIUS
    in_box = [np.array([-out, 0.04, 0]), np.array([-out, -0.04, 0]), np.array([out, 0, 0])]
    share = [-SQUEEZE / 2, -SQUEEZE / 2, SQUEEZE]
    tilt = PITCH - np.pi / 4
    weight = MASS * GRAVITY * np.sqrt(2) * np.array([np.sin(tilt), 0, np.cos(tilt)])
    places = [MIDDLE + rotation(PITCH) @ p for p in in_box]
    data.qpos[:9] = np.concatenate([angles(f, p) for f, p in enumerate(places)])
    drives, rows, middles = Drives(9), [], []
    for tick in range(round(1.5 * DURATION / PERIOD)):
        done = minimum_jerk((tick * PERIOD - 0.1) / DURATION)
        pitch, middle = PITCH + TURN * done, MIDDLE + WAY * done
        turn = rotation(pitch)
        middles.append(middle)
        reference = np.concatenate([angles(f, middle + turn @ p) for f, p in enumerate(in_box)])
        scratch.qpos[:] = data.qpos
        scratch.qpos[:9] = reference
        mujoco.mj_forward(model, scratch)
        forward = scratch.qfrc_bias[:9].copy()
        for f in range(3):
            force = turn @ (np.array([-share[f], 0, 0]) + weight * (0.5 if f == 2 else 0.25))
            forward[3 * f : 3 * f + 3] += jacobian(f, reference[3 * f : 3 * f + 3]).T @ force
        forward = forward.astype(np.float32).astype(float)
        joints = data.qpos[:9].copy()
        rows.append((forward, reference, data.qpos[9:12].copy(), data.qpos[[13, 14, 15, 12]], joints))
        drives.run(model, data, forward + STIFFNESS * (reference - joints))
    print(f"hand: box is off its reference by {1e3 * (rows[-1][2] - middle)} mm, and by up to "
          f"{max(1e3 * np.linalg.norm(r[2] - m) for r, m in zip(rows, middles)):.2f} mm")
    turned = 2 * np.arcsin(rows[-1][3][1]) - 2 * np.arcsin(rows[0][3][1])
    print(f"hand: box goes {1e3 * (rows[-1][2] - rows[0][2])} mm and turns {1e3 * turned:.2f} mrad")
    return rows


def literal(vector):
    return "[" + ", ".join(repr(round(float(x), 9)) for x in vector) + "]"


def main():
    text = "&[\n"
    for case in PINCH:
        values = ", ".join(literal(v) if isinstance(v, tuple) else repr(v) for v in case[1:8])
        text += f'    ("{case[0]}", {values}, &[\n'
        text += "".join(f"        ({', '.join(map(literal, row))}),\n" for row in pinch(case))
        text += "    ]),\n"
    write("contact_pinch.in", __file__, PINCH_COLUMNS, text + "]\n")
    rows = "".join(f"    ({', '.join(map(literal, row))}),\n" for row in hand())
    write("contact_hand.in", __file__, HAND_COLUMNS, f"({STIFFNESS!r}, {VISCOUS!r}, &[\n{rows}])\n")


if __name__ == "__main__":
    main()
