"""Writes data/impedance.in: positions of a mass on a spring and a damper that is released 30 mm off its
equilibrium, every 10 ms, by scipy's matrix exponential. M 1.5 kg, K 300 N/m; B 7.5, 30 and 90 N·s/m."""

import numpy as np
from scipy.linalg import expm

from data_file import write

COLUMNS = """
Releases of 1.5 kg on 300 N/m, 30 mm off.
Rows: damping [N s/m], positions every 10 ms [m].
"""

M, K, PERIOD, START = 1.5, 300.0, 0.01, 0.03

rows = []
for damping in (7.5, 30.0, 90.0):
    step = expm(np.array([[0.0, 1.0], [-K / M, -damping / M]]) * PERIOD)
    state, positions = np.array([START, 0.0]), []
    for _ in range(200):
        positions.append(state[0])
        state = step @ state
    rows.append(f"({damping}, &[{', '.join(f'{position:.12e}' for position in positions)}]),\n")
write("impedance.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")
