#!/usr/bin/env python3
"""Displacement of a tool under a force, by equation (2) of the Arm7 paper with the matrices of robots/arm7/laws/coupled.toml and
tool-axes.toml, which are built here from their meaning: soft and stiff directions, a centre of compliance, a
turned tool. SciPy's integration of the motion. Reference values for the scenario arm7-paper-matrices."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from data_file import write

COLUMNS = """
6 N push the tool along x of the base, rising within 0.3 s.
Rows, the first of coupled.toml, the second of tool-axes.toml with the tool turned by -90 degrees about y: displacement at rest
under 6 N along x, and along y [m, rad]; displacement 0.1, 0.2, 0.4 and 0.8 s after the force along x began [m, rad].
"""

FORCE, RAMP = 6.0, 0.3


def coupled():
    soft, stiff, up = np.array([1, 1, 0]) / np.sqrt(2), np.array([1, -1, 0]) / np.sqrt(2), np.array([0, 0, 1])

    def matrix(along, across, vertical, rotation):
        full = np.diag([0.0] * 3 + [rotation] * 3)
        for axis, value in ((soft, along), (stiff, across), (up, vertical)):
            full[:3, :3] += value * np.outer(axis, axis)
        return full

    return matrix(2, 3, 2, 0.008), matrix(30, 70, 35, 0.5), matrix(200, 800, 300, 16)


def tool_axes():
    x, y, z = 0.0, 0.0, -0.1  # centre of compliance
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    to_center = np.block([[np.eye(3), -cross], [np.zeros((3, 3)), np.eye(3)]])
    stiffness = to_center.T @ np.diag([500, 500, 200, 12, 12, 12]) @ to_center
    mass, damping = np.diag([1.5] * 3 + [0.008] * 3), np.diag([40, 40, 30, 0.5, 0.5, 0.5])
    both = np.kron(np.eye(2), Rotation.from_euler("y", -90, degrees=True).as_matrix())
    return [both @ matrix @ both.T for matrix in (mass, damping, stiffness)]


def row(matrices):
    m, b, k = matrices
    axis = np.eye(6)
    rests = [np.linalg.solve(k, FORCE * axis[i]) for i in (0, 1)]
    force = lambda t: FORCE * min(t / RAMP, 1.0) * axis[0]
    rate = lambda t, s: np.concatenate([s[6:], np.linalg.solve(m, force(t) - b @ s[6:] - k @ s[:6])])
    times = [0.1, 0.2, 0.4, 0.8]
    motion = solve_ivp(rate, (0, 0.8), np.zeros(12), t_eval=times, max_step=1e-3, rtol=1e-10, atol=1e-13)
    values = rests + [motion.y[:6, i] for i in range(len(times))]
    return "    [" + ", ".join("[" + ", ".join(f"{part + 0.0:.9f}" for part in value) + "]" for value in values) + "],\n"


if __name__ == "__main__":
    write("tool_push.in", __file__, COLUMNS, "&[\n" + row(coupled()) + row(tool_axes()) + "]\n")
