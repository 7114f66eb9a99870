#!/usr/bin/env python3
"""A box that a push draws through two resting tips, by Coulomb's law alone (SciPy).

The rig is that of host-sim/tests/plant/pinch.rs: two bars hang from hinges along y and press a box from both sides with
spherical tips, which rest. By symmetry the box moves across x and turns about it. At each tip, friction is against the
motion of the box there, f = -mu N v / |v|; a speed of 0.1 um/s replaces the edge at v = 0. The moments about a hinge,
0 = tau - ARM N + RADIUS (force of the box on the tip along z), give the normal force N.
"""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from data_file import write

COLUMNS = """
Motions: name; squeeze [N]; box above the tips [m]; force [N], point [m], begin, ramp and hold [s] of a
push;
a row for each tick of 10 ms.
Rows, of the box: position [m], orientation as quaternion x y z w.
"""

PERIOD, DURATION = 0.01, 0.3
RADIUS, ARM = 0.008, 0.1
SIZE, MASS, FRICTION, GRAVITY = np.array([0.098, 0.208, 0.060]), 0.023, 0.6, 9.81
INERTIA = MASS / 12 * (SIZE[1] ** 2 + SIZE[2] ** 2)
EDGE = 1e-7
SQUEEZE = 1.0

# name, push [N] at a point of the box [m], its begin, ramp and hold [s]
CASES = [
    ("slides", (0.0, 0.0, 1.7), (0.0, 0.0, 0.0), 0.1, 0.05, 0.02),
    ("slides askew", (0.0, 1.1, 1.3), (0.0, 0.0, 0.0), 0.1, 0.05, 0.0),
    ("slides and turns", (0.0, 1.4, 0.3), (0.0, 0.0, 0.001), 0.1, 0.05, 0.01),
]


def run(force, point, begin, ramp, hold):
    def change(t, state):
        y, z, turn, vy, vz, spin = state
        # From the middle of the box to the tips.
        ry, rz = -y, -z
        v = np.array([vy - spin * rz, vz + spin * ry])
        e = v / np.hypot(np.hypot(*v), EDGE)
        normal = SQUEEZE / (1 - FRICTION * e[1] * RADIUS / ARM)
        fy, fz = -FRICTION * normal * e
        s = t - begin
        share = np.clip(min(s, 2 * ramp + hold - s) / ramp, 0, 1)
        py, pz = share * force[1], share * force[2]
        ly = np.cos(turn) * point[1] - np.sin(turn) * point[2]
        lz = np.sin(turn) * point[1] + np.cos(turn) * point[2]
        moment = 2 * (ry * fz - rz * fy) + ly * pz - lz * py
        return [vy, vz, spin, (py + 2 * fy) / MASS, (pz + 2 * fz) / MASS - GRAVITY, moment / INERTIA]

    times = PERIOD * np.arange(round(DURATION / PERIOD))
    options = {"method": "Radau", "rtol": 1e-9, "atol": 1e-13, "max_step": 1e-4}
    solution = solve_ivp(change, (0, times[-1]), np.zeros(6), t_eval=times, **options)
    y, z, turn = solution.y[:3]
    return [((0.0, a, b - ARM), (np.sin(c / 2), 0.0, 0.0, np.cos(c / 2))) for a, b, c in zip(y, z, turn)]


def literal(vector):
    return "[" + ", ".join(repr(round(float(x), 9) + 0.0) for x in vector) + "]"


def main():
    text = "&[\n"
    for name, force, point, *times in CASES:
        rows = run(force, point, *times)
        way = 1e3 * np.subtract(rows[-1][0], rows[0][0])
        print(f"{name}: goes {way} mm, turns {2 * np.arcsin(rows[-1][1][0])} rad")
        values = ", ".join([repr(SQUEEZE), "0.0", literal(force), literal(point), *map(repr, times)])
        text += f'    ("{name}", {values}, &[\n'
        text += "".join(f"        ({', '.join(map(literal, row))}),\n" for row in rows)
        text += "    ]),\n"
    write("contact_sliding.in", __file__, COLUMNS, text + "]\n")


if __name__ == "__main__":
    main()
