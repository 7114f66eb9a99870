#!/usr/bin/env python3
"""Eigenvalues of the sampled loop of two coupled joints, each with a servo that knows one constant inertia, built from
matrices: held inputs, of which each acts after a delay. Reference values for `tesaki model init`."""

import numpy as np
from scipy.linalg import block_diag, expm

from data_file import write

COLUMNS = """
The first two joints of a SCARA in three postures, with three choices of bandwidths.
Rows: mass matrix M11, M12, M22 [kg m^2]; inertia that each servo assumes [kg m^2]; bandwidth of each position loop
[rad/s], and of each observer [rad/s]; largest absolute eigenvalue.
"""

T, LAG = 0.01, 0.0003 + 1 / (2 * np.pi * 300)
ROTOR, UPPER, LOWER = 0.0081, (3.0, 0.1, 0.02), (2.6, 0.1231, 0.0157)  # mass [kg], centre [m], inertia [kg m^2]
LENGTH = 0.25
ASSUMED = [0.2524, 0.03669]
BANDWIDTHS = [([20, 20], [80, 80]), ([10, 20], [80, 80]), ([10, 10], [80, 80])]


def mass_matrix(bend):
    (m1, c1, i1), (m2, c2, i2) = UPPER, LOWER
    coupled = m2 * LENGTH * c2 * np.cos(bend)
    own = i2 + m2 * c2**2
    return np.array(
        [[i1 + m1 * c1**2 + m2 * LENGTH**2 + own + 2 * coupled + ROTOR, own + coupled], [own + coupled, own + ROTOR]]
    )


def held(a, b, time):
    size = len(a)
    m = expm(np.block([[a, b], [np.zeros((b.shape[1], size + b.shape[1]))]]) * time)
    return m[:size, :size], m[:size, size:]


def servo(inertia, bandwidth, observer_bandwidth):
    """x' = a x + b e, u = c x + d e: state x = predicted error, its velocity, disturbance, last effort."""
    beta, gamma = np.exp(-observer_bandwidth * T), np.exp(-bandwidth * T)
    model, effort = held(np.array([[0, 1, 0], [0, 0, 1 / inertia], [0, 0, 0]]), np.array([[0], [-1 / inertia], [0]]), T)
    # Correction: the eigenvalues of model (1 - gain C) are all beta.
    observed = np.vstack([np.eye(3)[0] @ np.linalg.matrix_power(model, i) for i in range(3)])
    wanted = np.linalg.matrix_power(model - beta * np.eye(3), 3)
    gain = np.linalg.inv(model) @ wanted @ np.linalg.inv(observed) @ np.eye(3)[:, 2:]
    motion, torque = model[:2, :2], -effort[:2]
    reached = np.hstack([torque, motion @ torque])
    wanted = np.linalg.matrix_power(motion - gamma * np.eye(2), 2)
    feedback = np.append(np.eye(2)[1:] @ np.linalg.inv(reached) @ wanted, 1.0)[None, :]
    correct, innovation = np.eye(3) - gain @ np.eye(3)[:1], gain
    c, d = feedback @ correct, feedback @ innovation
    share = LAG / T
    a = model @ correct + (1 - share) * effort @ c
    b = model @ innovation + (1 - share) * effort @ d
    a = np.block([[a, share * effort], [c, np.zeros((1, 1))]])
    return a, np.vstack([b, d]), np.hstack([c, np.zeros((1, 1))]), d


def largest_eigenvalue(mass, servos):
    size = len(mass)
    plant = np.block([[np.zeros((size, size)), np.eye(size)], [np.zeros((size, 2 * size))]])
    torque = np.vstack([np.zeros((size, size)), -np.linalg.inv(mass)])
    first, before = held(plant, torque, LAG)
    second, after = held(plant, torque, T - LAG)
    a, b, c, d = (block_diag(*parts) for parts in zip(*servos))
    angle = np.hstack([np.eye(size), np.zeros((size, size))])
    last = block_diag(*[np.eye(4)[3:]] * size)
    loop = np.block([[second @ first + after @ d @ angle, second @ before @ last + after @ c], [b @ angle, a]])
    return max(abs(np.linalg.eigvals(loop)))


def main():
    lines = []
    for bend in (0.0, 1.2, 2.4):
        mass = mass_matrix(bend)
        for bandwidths, observers in BANDWIDTHS:
            servos = [servo(*values) for values in zip(ASSUMED, bandwidths, observers)]
            values = [mass[0, 0], mass[0, 1], mass[1, 1], *ASSUMED, *bandwidths, *observers]
            values.append(largest_eigenvalue(mass, servos))
            lines.append("    [" + ", ".join(repr(round(float(value), 6)) for value in values) + "],\n")
    write("coupled_servos.in", __file__, COLUMNS, "&[\n" + "".join(lines) + "]\n")


if __name__ == "__main__":
    main()
