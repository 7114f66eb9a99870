#!/usr/bin/env python3
"""Reference values for calibration matrices of six-axis force sensors, by NumPy in double precision."""

import numpy as np

from data_file import write

COLUMNS = """
Sensors with three beams, each with a bridge for bending about and one across its axis, at 120 degrees around z; the
sensitivities of all bridges differ, and each sees a part of the others.
Rows: calibration matrix [N and N m per count], resolutions [N, N m], a list of (counts of the gauges, wrench in counts of
the resolutions, before rounding), and the smallest magnitude on the diagonal of R in the QR decomposition of the
transposed matrix, columns and then rows scaled to length 1.
"""

END = 2**23


def sensitivity(rng, radius, capacity):
    """Returns the counts of the six bridges for 1 N and 1 N m: of the beam at each angle, the force along z
    and the tangential one, by equilibrium of a ring on three beams."""
    rows = []
    for angle in 2 * np.pi * np.arange(3) / 3:
        c, s = np.cos(angle), np.sin(angle)
        # Axial share of beam i: F_z / 3 and the moments about x and y; tangential: F_x, F_y and the moment about z.
        rows.append([0, 0, 1 / 3, 2 * s / (3 * radius), -2 * c / (3 * radius), 0])
        rows.append([-2 * s / 3, 2 * c / 3, 0, 0, 0, 1 / (3 * radius)])
    ideal = np.array(rows) * 0.4 * END / capacity
    unequal = np.diag(rng.uniform(0.7, 1.3, 6))
    crosstalk = np.eye(6) + rng.uniform(-0.08, 0.08, (6, 6))
    return crosstalk @ unequal @ ideal


def independence(matrix):
    scaled = matrix / np.linalg.norm(matrix, axis=0)
    scaled = scaled / np.linalg.norm(scaled, axis=1)[:, None]
    return np.abs(np.diag(np.linalg.qr(scaled.T)[1])).min()


def floats(values):
    return "[" + ", ".join(f"{value:.9e}" for value in values) + "]"


def single(values):
    return "[" + ", ".join(np.format_float_scientific(np.float32(value)) for value in values) + "]"


def main():
    rng = np.random.default_rng(20)
    rows = []
    for radius, capacity in ((0.008, 20.0), (0.015, 60.0), (0.03, 300.0)):
        matrix = np.linalg.inv(sensitivity(rng, radius, capacity)).astype(np.float32).astype(float)
        resolutions = np.float32([1e-3, 1e-5]).astype(float)
        samples = []
        for _ in range(8):
            wrench = rng.uniform(-1, 1, 6) * capacity * np.array([1, 1, 1, radius, radius, radius]) / 3
            gauges = np.round(np.linalg.solve(matrix, wrench)).astype(int)
            assert np.abs(gauges).max() < END
            counts = matrix @ gauges / np.repeat(resolutions, 3)
            samples.append(f"        ({list(map(int, gauges))}, {floats(counts)}),")
        listed = "\n".join(samples)
        text = ",\n        ".join(map(single, matrix))
        rows.append(f"    ([\n        {text},\n    ], [1e-3, 1e-5], &[\n{listed}\n    ], {independence(matrix):.6f}),")
    write("gauges.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")


if __name__ == "__main__":
    main()
