#!/usr/bin/env python3
"""The largest proportional gain with which a PID is stable on a pure inertia: eigenvalues of the sampled loop as a
matrix. Reference values for what `tesaki model check` says of the gains of a servo."""

import numpy as np

from data_file import write

COLUMNS = """
Limits of stability of a PID on an inertia, a row for each set of gains, all per inertia.
Rows: integral [1/s^3], derivative [1/s], cut-off of the derivative [rad/s], largest proportional [1/s^2].
The torque is held for 10 ms and begins 0.8305 ms late: 0.3 ms and 1/(2 pi 300 Hz).
"""

T = 0.01
LAG = (3e-4 + 1 / (2 * np.pi * 300)) / T


def radius(p, i, d, cutoff):
    """Largest eigenvalue of the map of [angle, velocity, last torque, integral, derivative, last angle] to those of the
    next tick, without a reference."""
    a = np.exp(-cutoff * T)
    derivative = np.array([-1, 0, 0, 0, 0, 1]) * (1 - a) / T + np.array([0, 0, 0, 0, a, 0])
    torque = np.array([-p, 0, 0, 1, 0, 0]) + d * derivative
    change = T * ((1 - LAG) * torque + LAG * np.array([0, 0, 1, 0, 0, 0]))
    angle, velocity = np.eye(6)[0], np.eye(6)[1]
    rows = [
        angle + T * velocity + T / 2 * change,
        velocity + change,
        torque,
        np.array([-i * T, 0, 0, 1, 0, 0]),
        derivative,
        angle,
    ]
    return max(abs(np.linalg.eigvals(np.array(rows))))


def limit(i, d, cutoff):
    # Below some gain the integral part is too large; above the limit nothing is stable.
    grid = np.arange(1.0, 4000.0)
    low = grid[[radius(p, i, d, cutoff) < 1 for p in grid]].max()
    high = low + 1
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if radius(middle, i, d, cutoff) < 1 else (low, middle)
    return low


if __name__ == "__main__":
    gains = [(4000, 75, 30), (2000, 40, 80), (500, 20, 40), (1000, 30, 60), (4000, 60, 60)]
    rows = [f"    [{i}.0, {d}.0, {cutoff}.0, {limit(i, d, cutoff):.2f}]," for i, d, cutoff in gains]
    write("pid_stability.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")
