"""Writes data/impedance_matrices.in: accelerations of target impedances with full matrices, by numpy's solution and
scipy's matrix exponential of the state-space form over a control period, and the same impedances in turned axes."""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from data_file import write

COLUMNS = """
Target impedances of six coupled axes.
Rows: diagonals and elements below them, row by row, of M [kg, kg m, kg m^2], B [N s/m, N s, N m s] and
K [N/m, N, N m]; displacement [m, rad], its velocity, external force [N, N m]; acceleration M^-1 (F - B v - K e);
mean acceleration over 10 ms of the exact motion [m/s^2, rad/s^2]; rotation matrix by rows to other axes; M, B and K in
these axes, as above.
"""

PERIOD = 0.01
# Typical sizes of the six axes: 1.5 kg, 0.02 kg m^2.
SCALE = np.diag(np.sqrt([1.5] * 3 + [0.02] * 3))


def random_matrix(random, eigenvalues):
    """Returns a symmetric matrix with these eigenvalues relative to SCALE squared."""
    q, _ = np.linalg.qr(random.normal(size=(6, 6)))
    return SCALE @ q @ np.diag(eigenvalues) @ q.T @ SCALE


def rounded(matrix):
    return np.float32(matrix).astype(float)


def rust(values):
    return "[" + ", ".join(f"{float(np.float32(x)):.9e}" for x in values) + "]"


def parts(matrix):
    below = [matrix[row, column] for row in range(6) for column in range(row)]
    return f"({rust(np.diag(matrix))}, {rust(below)})"


rows = []
random = np.random.default_rng(7)
for case in range(6):
    low_rank = case == 5
    mass = rounded(random_matrix(random, random.uniform(0.5, 2.0, 6)))
    # Up to 45 of the possible 100/s, and 1100 of 2500/s^2; the last has neither damper nor spring in some direction.
    damping = rounded(random_matrix(random, random.uniform(0.0, 22.0, 6) * ([0, 1, 1, 1, 1, 1] if low_rank else 1)))
    stiffness = rounded(random_matrix(random, random.uniform(0.0, 550.0, 6) * ([0, 0, 0, 1, 1, 1] if low_rank else 1)))
    error = rounded(random.uniform(-0.05, 0.05, 6))
    velocity = rounded(random.uniform(-0.3, 0.3, 6))
    force = rounded(random.uniform(-5.0, 5.0, 6) * [1, 1, 1, 0.1, 0.1, 0.1])
    printed = np.linalg.solve(mass, force - damping @ velocity - stiffness @ error)
    # State (e, v), with the constant force as a third part.
    system = np.zeros((18, 18))
    system[:6, 6:12] = np.eye(6)
    system[6:12, :6] = -np.linalg.solve(mass, stiffness)
    system[6:12, 6:12] = -np.linalg.solve(mass, damping)
    system[6:12, 12:] = np.linalg.inv(mass)
    after = expm(system * PERIOD) @ np.concatenate([error, velocity, force])
    held = (after[6:12] - velocity) / PERIOD
    turn = Rotation.from_rotvec(random.normal(size=3)).as_matrix()
    both = np.kron(np.eye(2), turn)
    turned = [both @ matrix @ both.T for matrix in (mass, damping, stiffness)]
    fields = [*map(parts, (mass, damping, stiffness)), *map(rust, (error, velocity, force, printed, held)),
              rust(turn.flatten()), *map(parts, turned)]
    rows.append("(" + ", ".join(fields) + "),\n")
write("impedance_matrices.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")
