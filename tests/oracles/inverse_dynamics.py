#!/usr/bin/env python3
"""Joint torques and mass matrices of serial chains from Pinocchio (double precision).

Random chains have 1 to 7 joints with arbitrary axes, origins and mass distributions, one of them a finger's size and
one an arm's. The arms of tests/robots follow, at random postures within their limits, each on a differently
tilted base, with rotors; an arm whose file has no masses gets random ones. Every number is rounded to single
precision before Pinocchio sees it, so that both sides compute the same thing.

The file holds, for each chain: its name; gravity; its joints as (translation, rotation as quaternion x y z w, axis,
mass, centre of mass, inertia xx yy zz xy xz yz, rotor inertia); the tip's frame in the last joint's as (translation,
rotation); the motions as (angles, velocities, accelerations, wrench on the tip in base axes, torques without the
wrench, torques with it, torques at these velocities without acceleration, mass matrix by rows).

Two checks: the torques are M q'' + h - J^T F; an arm with masses agrees with Pinocchio's own loader of the unrounded
file.
"""

import numpy as np
import pinocchio as pin
from kinematics import CHAINS, chain_model, fold, jacobian, quaternion, unit
from data_file import write

COLUMNS = """
Chains: name; gravity [m/s^2]; joints; frame of the tip in the last joint's (translation [m], rotation);
motions.
Joints: translation [m], rotation as quaternion x y z w, axis, mass [kg], centre of mass [m], inertia xx
yy zz xy xz yz [kg m^2], rotor inertia [kg m^2].
Motions: angles [rad], velocities [rad/s], accelerations [rad/s^2], wrench on the tip in base axes [N, N
m], torques without the wrench, torques with it, torques without acceleration [N m], mass matrix by rows
[kg m^2].
"""

FINGERS = ("hand3_finger1", "allegro_thumb")
rng = np.random.default_rng(20)


def f32(x):
    return np.asarray(x, dtype=np.float32).astype(float)


def random_quaternion():
    q = rng.normal(size=4)
    return f32(q / np.linalg.norm(q))


def random_axis(index):
    # Including the special directions z, x, -z.
    special = {0: [0, 0, 1], 1: [1, 0, 0], 2: [0, 0, -1]}
    if index in special and rng.random() < 0.7:
        return np.array(special[index], dtype=float)
    a = rng.normal(size=3)
    return f32(a / np.linalg.norm(a))


def random_inertia(mass, size):
    # Inertia of a random cloud of points: always physical.
    points = rng.normal(size=(8, 3)) * size
    points -= points.mean(axis=0)
    m = mass / 8
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for p in points)
    return f32(tensor)


def number(value):
    # The shortest decimal that is this single-precision number.
    return np.format_float_positional(np.float32(value), trim="0")


def array(values):
    return "[" + ", ".join(number(v) for v in np.ravel(values)) + "]"


def random_joints(n, size, mass):
    joints = []
    for i in range(n):
        place = f32(rng.uniform(-size, size, 3)), random_quaternion(), random_axis(i)
        m = float(f32(mass * rng.uniform(0.3, 1)))
        joints.append((*place, m, f32(rng.uniform(-size, size, 3) / 2), random_inertia(m, size / 4), 0.0))
    return joints


def real_joints(path, tip):
    moving, tip_place = fold(path, tip)
    loaded = pin.buildModelFromUrdf(str(path))
    bodies = [loaded.inertias[loaded.getJointId(joint.name)] for joint, _ in moving]
    joints = []
    for (joint, place), body in zip(moving, bodies):
        frame = f32(place.translation), f32(quaternion(place.rotation)), f32(unit(joint.axis))
        if all(body.mass == 0 for body in bodies):
            m = float(f32(rng.uniform(1, 4)))
            inertial = m, f32(rng.uniform(-0.1, 0.1, 3)), random_inertia(m, 0.05)
        else:
            inertial = float(f32(body.mass)), f32(body.lever), f32(body.inertia)
        # Rotor inertias of the same order as those of the arm's links about its axes.
        rotor = float(f32(rng.uniform(0.05, 0.5) if len(moving) > 4 else rng.uniform(1e-5, 3e-4)))
        joints.append((*frame, *inertial, rotor))
    limits = np.array([(max(joint.lower, -np.pi), min(joint.upper, np.pi)) for joint, _ in moving])
    return joints, (f32(tip_place.translation), f32(quaternion(tip_place.rotation))), limits, (loaded, moving, bodies)


def model_of(gravity, joints, tip):
    model = chain_model([joint[:3] for joint in joints], tip)
    for i, (*_, mass, center, inertia, _) in enumerate(joints, 1):
        model.appendBodyToJoint(i, pin.Inertia(mass, center, inertia), pin.SE3.Identity())
    model.gravity.linear = gravity
    model.armature = np.array([joint[-1] for joint in joints])
    return model


def check_against_loader(model, loaded, moving, bodies):
    """Checks that the torques of the folded chain are those of the file, if nothing else in it moves."""
    if loaded.nv != len(moving) or loaded.nq != loaded.nv or all(body.mass == 0 for body in bodies):
        return
    loaded.gravity, loaded.armature = model.gravity, model.armature
    q, v, a = rng.uniform(-3, 3, (3, loaded.nv))
    ours, theirs = (pin.rnea(m, m.createData(), q, v, a) for m in (model, loaded))
    assert np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


def motion(model, q, v, a, wrench):
    data = model.createData()
    free, h = pin.rnea(model, data, q, v, a), pin.nle(model, data, q, v)
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    frame, last = model.getFrameId("tip"), model.njoints - 1
    pin.framesForwardKinematics(model, data, q)
    force, moment = wrench[:3], wrench[3:]
    about_base = pin.Force(force, moment + np.cross(data.oMf[frame].translation, force))
    forces = [pin.Force.Zero() for _ in range(model.njoints)]
    forces[last] = data.oMi[last].actInv(about_base)
    loaded = pin.rnea(model, data, q, v, a, forces)
    j = jacobian(model, model.createData(), q, frame).reshape(6, -1)
    for got, expected in ((free, mass @ a + h), (loaded, free - j.T @ wrench)):
        assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max() + 1e-12, (got, expected)
    numbers = ", ".join(f"&{array(x)}" for x in (q, v, a))
    results = ", ".join(f"&{array(x)}" for x in (free, loaded, h, mass))
    return f"({numbers}, {array(wrench)}, {results})"


def case(name, gravity, joints, tip, limits, speed, acceleration, wrench, count):
    model = model_of(gravity, joints, tip)
    motions = []
    for _ in range(count):
        q, signs = f32(rng.uniform(*limits.T)), rng.normal(size=(2, len(joints)))
        load = f32(rng.normal(size=6) * wrench)
        motions.append(motion(model, q, f32(signs[0] * speed), f32(signs[1] * acceleration), load))
    lines = []
    for xyz, quat, axis, mass, center, i, rotor in joints:
        six = i[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        arrays = f"{array(xyz)}, {array(quat)}, {array(axis)}, {number(mass)}, {array(center)}, {array(six)}"
        lines.append(f"({arrays}, {number(rotor)})")
    place, joints, motions = f"({array(tip[0])}, {array(tip[1])})", ",\n        ".join(lines), ",\n        ".join(motions)
    return f'    ("{name}", {array(gravity)}, &[\n        {joints},\n    ], {place}, &[\n        {motions},\n    ]),'


def random_case(n, size, mass):
    gravity, joints = f32(rng.normal(size=3) * 6), random_joints(n, size, mass)
    tip, limits = (f32(rng.uniform(-size, size, 3)), random_quaternion()), np.array([[-3.0, 3.0]] * n)
    # Wrenches of the order of the weight.
    wrench = 10 * mass * np.array([1, 1, 1, size, size, size])
    return case(f"random_{n}", gravity, joints, tip, limits, 3, 20, wrench, 4)


def real_case(name, path, tip):
    joints, tip, limits, loaded = real_joints(path, tip)
    gravity = f32(9.81 * unit(rng.normal(size=3)))
    check_against_loader(model_of(gravity, joints, tip), *loaded)
    finger = name in FINGERS
    wrench = np.array([2.0] * 3 + [0.05] * 3) if finger else np.array([50.0] * 3 + [10.0] * 3)
    return case(name, gravity, joints, tip, limits, 2, 10, wrench, 12)


if __name__ == "__main__":
    sizes = [(3, 0.05, 0.05), (7, 0.3, 2.0)] + [(n, 0.2, 1.0) for n in (1, 2, 4, 5, 6, 7)]
    cases = [random_case(*size) for size in sizes]
    arms = [chain for chain in CHAINS if chain[0] in FINGERS or len(fold(*chain[1:])[0]) > 5]
    cases += [real_case(*chain) for chain in arms]
    write("inverse_dynamics.in", __file__, COLUMNS, "&[\n" + "\n".join(cases) + "\n]\n")
    print(*(chain[0] for chain in arms))
