#!/usr/bin/env python3
"""Joint torques of three fingers under the control of an object's pose of the Hand3 paper, equations (16) to (20): an object that
does not follow its target. Fingers, contacts and frame of accumulated_targets.py; the pseudo-inverse is NumPy's."""

import numpy as np

from accumulated_targets import NORMALS, RADIUS, ROOTS, jacobian, link_rotation, start, tip, triangle
from data_file import write

COLUMNS = """
Nine joint torques [N m] for the internal force of 1 N, a load of 50 g, and the PI control of a pose that stays while its target has
moved by (2, 1, 3) mm and 0.02 rad about y within 1 s, 0.1 s after that. Gains: 200 N/m, 400 N/(m s), 2 N m/rad, 4 N m/(rad s).
"""

T = 0.01
SHIFT, TURN = np.array([0.002, 0.001, 0.003]), np.array([0, 0.02, 0])
GAINS = np.array([[200, 400], [2, 4]])
MASS, GRAVITY = 0.05, np.array([0, 0, -9.81])


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def torques(gravity=GRAVITY):
    progress = lambda s: s**3 * (10 - 15 * s + 6 * s**2)
    integral = sum(progress(min(tick * T, 1.0)) * T for tick in range(1, 111))
    # The object lags its target by the motion.
    force = SHIFT * (GAINS[0] @ [1, integral]) - MASS * gravity
    moment = TURN * (GAINS[1] @ [1, integral])
    centers = np.array([tip(root, q) for root, q in zip(ROOTS, start)])
    origin, _ = triangle(centers)
    points = centers + RADIUS * NORMALS
    grasp = np.vstack([np.hstack([np.eye(3)] * 3), np.hstack([cross(point - origin) for point in points])])
    contact = np.linalg.pinv(grasp) @ np.concatenate([force, moment])
    internal = np.concatenate([NORMALS[0] * 0.5, NORMALS[1] * 0.5, NORMALS[2]])
    assert np.abs(grasp @ internal).max() < 1e-12
    forces = (contact + internal).reshape(3, 3)
    result = []
    for root, q, normal, force in zip(ROOTS, start, NORMALS, forces):
        lever = np.array([np.cross(w, RADIUS * normal) for w in link_rotation(q).T]).T
        result.append((jacobian(root, q) + lever).T @ force)
    return np.concatenate(result)


if __name__ == "__main__":
    write("object_control.in", __file__, COLUMNS, "[" + ", ".join(f"{value:.7f}" for value in torques()) + "]\n")
