#!/usr/bin/env python3
"""Joint torques of random serial chains from Pinocchio's recursive Newton-Euler algorithm (double precision).

The chains have 1 to 7 joints with arbitrary axes, origins and mass distributions, one of them a finger's size and one
an arm's. Every number is rounded to single precision before Pinocchio sees it, so that both sides compute the same
thing.
"""

from pathlib import Path

import numpy as np
import pinocchio as pin

DATA = Path(__file__).parent / "data"
rng = np.random.default_rng(20)


def f32(x):
    return np.asarray(x, dtype=np.float32).astype(float)


def random_quaternion():
    q = rng.normal(size=4)
    return f32(q / np.linalg.norm(q))


def random_axis(index):
    # The special directions, too: z, x, -z.
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


def case(n, size, mass):
    gravity = f32(rng.normal(size=3) * 6)
    model = pin.Model()
    model.gravity.linear = gravity
    parent, joints = 0, []
    for i in range(n):
        xyz, quat, axis = f32(rng.uniform(-size, size, 3)), random_quaternion(), random_axis(i)
        m = float(f32(mass * rng.uniform(0.3, 1)))
        com, inertia = f32(rng.uniform(-size, size, 3) / 2), random_inertia(m, size / 4)
        rotation = pin.Quaternion(quat[3], quat[0], quat[1], quat[2]).normalized().toRotationMatrix()
        parent = model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis)), pin.SE3(rotation, xyz), f"j{i}"
        )
        model.appendBodyToJoint(parent, pin.Inertia(m, com, inertia), pin.SE3.Identity())
        six = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        joints.append(f"({array(xyz)}, {array(quat)}, {array(axis)}, {number(m)}, {array(com)}, {array(six)})")
    data = model.createData()
    motions = []
    for _ in range(4):
        q, v, a = f32(rng.uniform(-3, 3, n)), f32(rng.normal(size=n) * 3), f32(rng.normal(size=n) * 20)
        tau = pin.rnea(model, data, q, v, a)
        motions.append(f"(&{array(q)}, &{array(v)}, &{array(a)}, &{array(tau)})")
    joints, motions = ",\n        ".join(joints), ",\n        ".join(motions)
    return f"    ({array(gravity)}, &[\n        {joints},\n    ], &[\n        {motions},\n    ]),"


if __name__ == "__main__":
    cases = [case(3, 0.05, 0.05), case(7, 0.3, 2.0)] + [case(n, 0.2, 1.0) for n in (1, 2, 4, 5, 6, 7)]
    (DATA / "inverse_dynamics.in").write_text("&[\n" + "\n".join(cases) + "\n]\n")
