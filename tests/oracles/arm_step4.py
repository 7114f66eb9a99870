"""Writes data/arm_step4.in: joint accelerations of an arm with seven joints by step 4 of the Arm7 paper. Jacobian and
J' q' are difference quotients of the forward kinematics; numpy inverts."""

import numpy as np

from data_file import write

COLUMNS = """
Joint accelerations of the arm in shared/src/task/impedance/tests/fixture.rs.
Rows: joint angles [rad] and velocities [rad/s], acceleration of the tool [m/s^2, rad/s^2], acceleration of joint 2,
the driven one [rad/s^2]; joint accelerations: of the other six by the inverse 6 x 6 Jacobian without the term of the
driven joint, as printed; with it; by the pseudo-inverse of all seven, eq. (3) for accelerations [rad/s^2].
"""

AXES = [[0, -1, 0], [-1, 0, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, -1, 0], [1, 0, 0]]
HEIGHTS = [0, 0, 0, -0.3, -0.26, 0, 0]
TIP = [0, 0, -0.1]
DRIVEN = 2
STEP = 1e-4


def turn(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def tool(angles):
    """Returns rotation and position of the tip."""
    rotation, position = np.eye(3), np.zeros(3)
    for axis, height, angle in zip(AXES, HEIGHTS, angles):
        position = position + rotation @ [0, 0, height]
        rotation = rotation @ turn(axis, angle)
    return rotation, position + rotation @ TIP


def jacobian(angles):
    columns = []
    for joint in range(7):
        step = np.eye(7)[joint] * STEP
        (r1, p1), (r0, p0) = tool(angles + step), tool(angles - step)
        spin = (r1 - r0) / (2 * STEP) @ tool(angles)[0].T
        columns.append(np.concatenate([(p1 - p0) / (2 * STEP), [spin[2, 1], spin[0, 2], spin[1, 0]]]))
    return np.array(columns).T


def rust(values):
    return "[" + ", ".join(f"{x:.9e}" for x in values) + "]"


rows = []
random = np.random.default_rng(11)
for angles in ([0, 0, 0, np.pi / 2, 0, 0, 0], [0.9, 0.3, -0.4, 1.2, 0.3, 0.4, -0.2], [0.3, 0.6, 0.8, 1.9, -0.9, -0.5, 0.6]):
    angles = np.array(angles, dtype=float)
    velocities, desired = random.uniform(-1, 1, 7), random.uniform(-2, 2, 6)
    driven = random.uniform(2, 5)
    j = jacobian(angles)
    bias = (jacobian(angles + velocities * STEP) - jacobian(angles - velocities * STEP)) / (2 * STEP) @ velocities
    others = [joint for joint in range(7) if joint != DRIVEN]
    results = []
    for right in (desired - bias, desired - bias - j[:, DRIVEN] * driven):
        accelerations = np.zeros(7)
        accelerations[others] = np.linalg.solve(j[:, others], right)
        accelerations[DRIVEN] = driven
        results.append(accelerations)
    results.append(np.linalg.pinv(j) @ (desired - bias))
    values = ", ".join(map(rust, (angles, velocities, desired)))
    rows.append(f"({values}, {driven:.9e}, {', '.join(map(rust, results))}),\n")
write("arm_step4.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")
