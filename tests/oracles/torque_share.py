#!/usr/bin/env python3
"""The least share of their torque that the joints of a hand need to hold an object: SciPy's linear programs (HiGHS).

Random hands of three fingers of three joints at random contacts, with friction cones as pyramids of 720
edges, which is close enough to round. Writes data/torque_share.in.
"""

import numpy as np
from scipy.optimize import linprog

from data_file import write

COLUMNS = """
Rows: friction [1]; for each finger contact point [m], normal, block of the Jacobian by rows [m], torques of its weight,
capacities [N m]; load, force [N] and moment [N m]; least share of the torque, negative where no forces hold the load.
"""
EDGES = 720


def rounded(values):
    """Rounds values as they are written."""
    return np.vectorize(lambda value: float(f"{value:.7e}"))(values)


def share(friction, fingers, load):
    columns = 3 * EDGES + 1
    balance, torques, room = np.zeros((6, columns)), [], []
    turn = 2.0 * np.pi * np.arange(EDGES) / EDGES
    for index, (point, normal, block, weight, capacity) in enumerate(fingers):
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        second = np.cross(normal, first)
        edges = normal + friction * (np.outer(np.cos(turn), first) + np.outer(np.sin(turn), second))
        own = slice(index * EDGES, (index + 1) * EDGES)
        balance[:3, own], balance[3:, own] = edges.T, np.cross(point, edges).T
        for joint in range(3):
            for sign in (1.0, -1.0):
                row = np.zeros(columns)
                row[own], row[-1] = sign * edges @ block[:, joint], -capacity[joint]
                torques.append(row)
                room.append(-sign * weight[joint])
    costs = np.zeros(columns)
    costs[-1] = 1.0
    found = linprog(costs, A_ub=np.array(torques), b_ub=room, A_eq=balance, b_eq=-load)
    return found.fun if found.status == 0 else -1.0


def main():
    random = np.random.default_rng(18)
    rows = []
    for case in range(16):
        friction = rounded(random.uniform(0.2, 0.9))
        # Every fourth hand has its fingers on one side, and holds only an object that is pressed against
        # them.
        around = [0.0, 40.0, 80.0] if case % 4 == 3 else [0.0, 120.0, 240.0]
        directions = np.radians(around) + random.uniform(-0.4, 0.4, 3)
        fingers = []
        for angle in directions:
            normal = -np.array([np.cos(angle), np.sin(angle), random.uniform(-0.2, 0.2)])
            normal /= np.linalg.norm(normal)
            block, weight = random.uniform(-0.1, 0.1, (3, 3)), random.uniform(-0.03, 0.03, 3)
            parts = (-0.04 * normal, normal, block, weight, random.uniform(0.4, 0.8, 3))
            fingers.append(tuple(map(rounded, parts)))
        load = rounded(np.concatenate([random.uniform(-5.0, 5.0, 3), random.uniform(-0.03, 0.03, 3)]))
        rows.append((friction, fingers, load, share(friction, fingers, load)))
    lines = []
    for friction, fingers, load, value in rows:
        of_fingers = ", ".join(listed(np.concatenate([part.ravel() for part in finger])) for finger in fingers)
        lines.append(f"    ({float(friction):.7e}, [{of_fingers}], {listed(load)}, {float(value):.9e}),\n")
    write("torque_share.in", __file__, COLUMNS, "&[\n" + "".join(lines) + "]\n")


def listed(values):
    return "[" + ", ".join(f"{float(value):.7e}" for value in values) + "]"


if __name__ == "__main__":
    main()
