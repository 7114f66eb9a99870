#!/usr/bin/env python3
"""Tip pose, Jacobian and bias acceleration of chains of real robots from Pinocchio (double precision).

Each chain is read from its URDF here, fixed joints folded in, and every number rounded to single precision before
Pinocchio sees it, so that both sides compute the same thing. Two checks come first: the folded chain agrees with
Pinocchio's own loader of the unrounded file; the bias agrees with the finite difference of the Jacobian.
A mimic joint counts as a joint of its own here.

The file holds, for each chain: its name; its moving joints as (translation, rotation as quaternion x y z w, axis in
the joint's frame); the tip's frame in the last joint's as (translation, rotation); the states as (angles, velocities,
tip position, rotation matrix by rows, Jacobian by rows, bias). The Jacobian's rows: linear velocity of the tip, then
angular velocity, in base axes. The bias is the tip's acceleration at these velocities without joint acceleration:
linear (of the tip as a point), then angular, in base axes. First the zero posture, even if outside the
limits, then one close to a singularity, then random ones within the limits.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from data_file import write

COLUMNS = """
Chains: name; joints (translation [m], rotation as quaternion x y z w, axis);
frame of the tip in the last joint's (translation [m], rotation); states.
States: angles [rad], velocities [rad/s], tip position [m], rotation matrix by rows, Jacobian by rows [m,
1], bias acceleration [m/s^2, rad/s^2].
"""

HERE = Path(__file__).parent
ROBOTS = HERE / "../robots"
HAND3 = HERE / "../../robots/hand3/robot.urdf"
RANDOM_STATES = 20

# Name; file; tip.
CHAINS = [
    ("franka_panda", ROBOTS / "franka_panda.urdf", "panda_hand_tcp"),
    ("ur5e", ROBOTS / "ur5e.urdf", "tool0"),
    ("kuka_iiwa14", ROBOTS / "kuka_iiwa14.urdf", "tool0"),
    ("kinova_gen3", ROBOTS / "kinova_gen3.urdf", "end_effector_link"),
    ("kinova_j2s6s200", ROBOTS / "kinova_j2s6s200.urdf", "j2s6s200_end_effector"),
    ("abb_irb140", ROBOTS / "abb_irb140.urdf", "tool0"),
    ("ufactory_xarm7", ROBOTS / "ufactory_xarm7.urdf", "link_eef"),
    ("allegro_index", ROBOTS / "allegro_right.urdf", "link_3.0_tip"),
    ("allegro_thumb", ROBOTS / "allegro_right.urdf", "link_15.0_tip"),
    ("robotiq_left", ROBOTS / "robotiq_2f85.urdf", "left_inner_finger_pad"),
    ("robotiq_right", ROBOTS / "robotiq_2f85.urdf", "right_inner_finger_pad"),
    ("inspire_index", ROBOTS / "inspire_right.urdf", "R_index_tip"),
    ("inspire_thumb", ROBOTS / "inspire_right.urdf", "R_thumb_tip"),
    ("hand3_finger1", HAND3, "finger1_tip"),
    ("hand3_finger2", HAND3, "finger2_tip"),
    ("hand3_finger3", HAND3, "finger3_tip"),
]


def vector(element, tag, attribute, default):
    found = element.find(tag)
    text = None if found is None else found.get(attribute)
    return np.array(default if text is None else [float(word) for word in text.split()])


def rotation(rpy):
    """Returns the rotation of roll, pitch, yaw about fixed axes."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def quaternion(matrix):
    """x y z w, w not negative."""
    q = pin.Quaternion(matrix).normalized().coeffs()
    return -q if q[3] < 0 else q


class Joint:
    def __init__(self, element):
        self.name, self.type = element.get("name"), element.get("type")
        self.parent, self.child = element.find("parent").get("link"), element.find("child").get("link")
        zero = [0, 0, 0]
        rpy, xyz = vector(element, "origin", "rpy", zero), vector(element, "origin", "xyz", zero)
        self.place = pin.SE3(rotation(rpy), xyz)
        self.axis = vector(element, "axis", "xyz", [1, 0, 0])
        limit = element.find("limit")
        bounded = self.type == "revolute"
        self.lower = float(limit.get("lower", 0)) if bounded else -np.pi
        self.upper = float(limit.get("upper", 0)) if bounded else np.pi
        mimic = element.find("mimic")
        self.mimic = None
        if mimic is not None:
            self.mimic = mimic.get("joint"), float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))


def joints_of(path):
    return [Joint(element) for element in ET.parse(path).getroot().findall("joint")]


def fold(path, tip):
    """Returns the moving joints from the base to the tip, each with its frame in the previous moving joint's,
    and the tip's frame."""
    to_link = {joint.child: joint for joint in joints_of(path)}
    way = []
    while tip in to_link:
        way.insert(0, to_link[tip])
        tip = way[0].parent
    moving, place = [], pin.SE3.Identity()
    for joint in way:
        place = place * joint.place
        if joint.type != "fixed":
            assert joint.type in ("revolute", "continuous"), joint.name
            moving.append((joint, place))
            place = pin.SE3.Identity()
    return moving, place


def f32(x):
    return np.asarray(x, dtype=np.float32).astype(float)


def unit(x):
    return x / np.linalg.norm(x)


def chain_model(joints, tip):
    """`joints`: translation, quaternion, axis; `tip`: translation, quaternion."""
    model, parent = pin.Model(), 0
    for i, (xyz, q, axis) in enumerate(joints):
        place = pin.SE3(pin.Quaternion(*unit(q)[[3, 0, 1, 2]]), xyz)
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(unit(axis)), place, f"j{i}")
    place = pin.SE3(pin.Quaternion(*unit(tip[1])[[3, 0, 1, 2]]), tip[0])
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    return model


def jacobian(model, data, q, frame):
    return pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)


def check_against_loader(path, tip, names, model):
    """Checks that the chain agrees with what Pinocchio itself reads from the file, in pose and Jacobian."""
    loaded = pin.buildModelFromUrdf(str(path))
    data, loaded_data = model.createData(), loaded.createData()
    ids = [loaded.getJointId(name) for name in names]
    frame, loaded_frame = model.getFrameId("tip"), loaded.getFrameId(tip)
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, loaded_q = rng.uniform(-3, 3, len(names)), pin.neutral(loaded)
        for angle, i in zip(q, ids):
            # A continuous joint's configuration is cosine and sine.
            start, size = loaded.joints[i].idx_q, loaded.joints[i].nq
            loaded_q[start : start + size] = [np.cos(angle), np.sin(angle)] if size == 2 else angle
        j = jacobian(model, data, q, frame)
        loaded_j = jacobian(loaded, loaded_data, loaded_q, loaded_frame)
        pin.framesForwardKinematics(model, data, q)
        pin.framesForwardKinematics(loaded, loaded_data, loaded_q)
        place, loaded_place = data.oMf[frame], loaded_data.oMf[loaded_frame]
        assert np.abs(place.homogeneous - loaded_place.homogeneous).max() < 1e-6, (path, tip)
        columns = [loaded.joints[i].idx_v for i in ids]
        assert np.abs(j - loaded_j[:, columns]).max() < 1e-6, (path, tip)
        assert np.abs(np.delete(loaded_j, columns, axis=1)).max(initial=0) == 0, (path, tip)


def near_singular(model, lower, upper, rng):
    """Returns a posture within the limits, close to that of the least singular value of the Jacobian.

    Of the whole Jacobian for an arm, of the linear part for a finger.
    """
    data, frame = model.createData(), model.getFrameId("tip")
    rows = slice(0, 6 if model.nq >= 6 else 3)

    def least(q):
        return np.linalg.svd(jacobian(model, data, q, frame)[rows], compute_uv=False)[-1]

    runs = []
    for _ in range(20):
        start = rng.uniform(lower, upper)
        runs.append(minimize(least, start, method="Nelder-Mead", bounds=list(zip(lower, upper))))
    best = f32(min(runs, key=lambda run: run.fun).x)
    q, step = best, 1e-3
    while least(q) < 1e-5:
        q = f32(np.clip(best + rng.uniform(-step, step, model.nq), lower, upper))
        step *= 1.5
    return q, least(q)


def state(model, q, qd):
    data, frame = model.createData(), model.getFrameId("tip")
    j = jacobian(model, data, q, frame)
    pin.forwardKinematics(model, data, q, qd, np.zeros_like(q))
    place = pin.updateFramePlacement(model, data, frame)
    bias = pin.getFrameClassicalAcceleration(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED).vector
    step = 1e-5
    ahead = jacobian(model, data, q + step * qd, frame) @ qd
    behind = jacobian(model, data, q - step * qd, frame) @ qd
    difference = (ahead - behind) / (2 * step)
    assert np.abs(bias - difference).max() <= 1e-6 * np.abs(bias).max() + 1e-12, (bias, difference)
    return place.translation, place.rotation, j, bias


def single(values):
    # The shortest decimals that are these single-precision numbers.
    return "[" + ", ".join(np.format_float_positional(np.float32(v), trim="0") for v in np.ravel(values)) + "]"


def double(values):
    # `+ 0.0`: no negative zeros.
    return "[" + ", ".join(repr(float(v) + 0.0) for v in np.ravel(values)) + "]"


def case(name, path, tip, seed):
    rng = np.random.default_rng([21, seed])
    moving, tip_place = fold(path, tip)
    exact = [(place.translation, quaternion(place.rotation), unit(joint.axis)) for joint, place in moving]
    exact_tip = tip_place.translation, quaternion(tip_place.rotation)
    rounded, rounded_tip = [tuple(map(f32, joint)) for joint in exact], tuple(map(f32, exact_tip))
    model = chain_model(rounded, rounded_tip)
    names = [joint.name for joint, _ in moving]
    check_against_loader(path, tip, names, chain_model(exact, exact_tip))
    check_against_loader(path, tip, names, model)

    lower = np.array([joint.lower for joint, _ in moving])
    upper = np.array([joint.upper for joint, _ in moving])
    singular, value = near_singular(model, lower, upper, rng)
    print(f"{name:16} {len(names)} joints, least singular value {value:.1e} at the near-singular posture")
    postures = [np.zeros(len(names)), singular] + [f32(rng.uniform(lower, upper)) for _ in range(RANDOM_STATES)]
    states = []
    for q in postures:
        qd = f32(rng.uniform(-2, 2, len(names)))
        position, orientation, j, bias = state(model, q, qd)
        inputs = f"&{single(q)}, &{single(qd)}"
        states.append(f"({inputs}, {double(position)}, {double(orientation)}, &{double(j)}, {double(bias)})")
    joints = ",\n        ".join(f"({single(xyz)}, {single(quat)}, {single(axis)})" for xyz, quat, axis in rounded)
    tip_text, states = f"({single(rounded_tip[0])}, {single(rounded_tip[1])})", ",\n        ".join(states)
    return f'    ("{name}", &[\n        {joints},\n    ], {tip_text}, &[\n        {states},\n    ]),'


if __name__ == "__main__":
    cases = [case(*chain, seed) for seed, chain in enumerate(CHAINS)]
    write("kinematics.in", __file__, COLUMNS, "&[\n" + "\n".join(cases) + "\n]\n")
