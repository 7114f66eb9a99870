#!/usr/bin/env python3
"""Bilateral control with matched impedances along one axis and about another: master and slave as masses on springs and
dampers, the operator's hand at one end, a wall at the other. One linear system, discretised by the matrix
exponential; sampled values are held for 10 ms. Reference values for tesaki::teleop::MatchedImpedance."""

import numpy as np
from scipy.linalg import expm

from data_file import write

COLUMNS = """
A hand that leads a master by 5 cm and 0.2 rad against walls, a row for each tick of 10 ms.
Rows: positions of master and slave [m], wrench of the operator and of the wall [N]; the same of the rotation [rad, N m].
"""

T = 0.01
# Mass, damping, stiffness: of the impedance at both ends, of the operator's arm without the handle; stiffness and damping
# of the wall; where the operator leads the handle.
ALONG = ((1.5, 30.0, 300.0), (1.5, 15.0, 300.0), (2000.0, 20.0), 0.05)
ABOUT = ((0.008, 0.5, 16.0), (0.004, 0.1, 3.0), (20.0, 0.1), 0.2)


def simulate(values, ticks=200, delay=0):
    (m, b, k), (mo, bo, ko), (kw, bw), goal = values
    # Master x v, slave x v; held: motor of the master, equilibrium of the slave, goal of the operator.
    a = np.zeros((7, 7))
    a[0, 1] = a[2, 3] = 1
    a[1] = np.array([-ko, -bo, 0, 0, 1, 0, ko]) / (m + mo)
    a[3] = np.array([0, 0, -k - kw, -b - bw, 0, k, 0]) / m
    step = expm(a * T)
    state = np.zeros(7)
    state[6] = goal
    before, motor, rows = 0.0, 0.0, []
    to_slave, to_master = [(0.0, 0.0)] * (delay + 1), [(0.0, 0.0)] * (delay + 1)
    for _ in range(ticks):
        xm, vm, xs, vs = state[:4]
        operator = m * (vm - before) / T - motor  # mean of the last period
        wall = -kw * xs - bw * vs
        rows.append((xm, xs, operator, wall))
        to_slave.append((xm, operator))
        to_master.append((xs, wall))
        x, f = to_slave[-1 - delay]
        other, force = to_master[-1 - delay]
        motor = force - b * vm - k * (xm - other)
        before = vm
        state[4], state[5] = motor, x + f / k
        state = step @ state
    return rows


if __name__ == "__main__":
    rows = zip(simulate(ALONG), simulate(ABOUT))
    lines = [f"    [{', '.join(repr(float(v)) for v in along + about)}]," for along, about in rows]
    write("matched_impedance.in", __file__, COLUMNS, "&[\n" + "\n".join(lines) + "\n]\n")
