#!/usr/bin/env python3
"""Joint angles of three fingers that hold an object which is shifted and turned: the sum of the joints' changes of equation (25)
of the Hand3 paper, here its integral by SciPy, with D_F, J_F and D_o from closed-form forward kinematics and difference
quotients. The fingers of the core's test: hand3's links, roots at (0, 0, 0), (0, 100, 0) and (300, 50, 0) mm, all upright."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from data_file import write

COLUMNS = """
Nine joint angles [rad] before a motion of the held object by (2, 1, 3) mm and 0.06 rad about (0, 1, 0) and 0.03 rad about
(0, 0, 1), and the changes of these angles after it.
"""

ROOTS = np.array([[0, 0, 0], [0, 0.1, 0], [0.3, 0.05, 0]])
L1, L2, L3, RADIUS = 0.039, 0.046, 0.05178, 0.008
SHIFT, TURN = np.array([0.002, 0.001, 0.003]), np.array([0, 0.06, 0.03])
# Where the approach begins, and how far it proceeds until the object presses [m]; rows: fingers.
BEGIN = np.array([[0, 0.5, 0.8], [0, 0.5, 0.8], [0, -0.5, -0.8]])
AHEAD = np.array([1.9e-4, 1.9e-4, -1.9e-4])
NORMALS = np.array([[1.0, 0, 0], [1, 0, 0], [-1, 0, 0]])


def tip(root, q):
    r = L2 * np.sin(q[1]) + L3 * np.sin(q[1] + q[2])
    z = L1 + L2 * np.cos(q[1]) + L3 * np.cos(q[1] + q[2])
    return root + [r * np.cos(q[0]), r * np.sin(q[0]), z]


def link_rotation(q):
    """Returns the angular velocity of the last link per joint velocity: about z, and twice about the turned y
    axis."""
    y = [-np.sin(q[0]), np.cos(q[0]), 0]
    return np.array([[0, 0, 1], y, y]).T


def jacobian(root, q):
    step = 1e-7 * np.eye(3)
    return np.array([(tip(root, q + d) - tip(root, q - d)) / 2e-7 for d in step]).T


def triangle(centers):
    """Returns the frame of the fingertips (section 5.1): origin, columns x towards finger 3, y, z."""
    origin = centers.mean(axis=0)
    z = np.cross(centers[1] - centers[0], centers[2] - centers[0])
    z /= np.linalg.norm(z)
    x = centers[2] - origin
    x -= z * (x @ z)
    x /= np.linalg.norm(x)
    return origin, np.array([x, np.cross(z, x), z]).T


def solve_reach(root, target, start):
    q = start.copy()
    for _ in range(50):
        q += np.linalg.solve(jacobian(root, q), target - tip(root, q))
    return q


start = np.array([solve_reach(root, tip(root, q) + [ahead, 0, 0], q) for root, q, ahead in zip(ROOTS, BEGIN, AHEAD)])
_, axes = triangle(np.array([tip(root, q) for root, q in zip(ROOTS, start)]))
normals_in_object = NORMALS @ axes


def rate(_, flat):
    q = flat.reshape(3, 3)
    centers = np.array([tip(root, angles) for root, angles in zip(ROOTS, q)])
    origin, frame = triangle(centers)
    rates = []
    for root, angles, center, normal in zip(ROOTS, q, centers, normals_in_object @ frame.T):
        lever = RADIUS * normal
        of_finger = jacobian(root, angles) + np.array([np.cross(w, lever) for w in link_rotation(angles).T]).T
        of_object = SHIFT + np.cross(TURN, center + lever - origin)
        rates.append(np.linalg.solve(of_finger, of_object))
    return np.concatenate(rates)


if __name__ == "__main__":
    end = solve_ivp(rate, (0, 1), start.flatten(), rtol=1e-9, atol=1e-11).y[:, -1]
    text = lambda values: "[" + ", ".join(f"{value:.7f}" for value in values) + "]"
    write("accumulated_targets.in", __file__, COLUMNS, f"[{text(start.flatten())}, {text(end - start.flatten())}]\n")
