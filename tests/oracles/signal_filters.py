#!/usr/bin/env python3
"""Reference values for tesaki::signal, from SciPy's continuous-time and first-order-hold models."""

import numpy as np
from scipy import signal

from data_file import write

STEP_COLUMNS = """
The step response of 1/(0.2 s + 1)^2, in ticks of 10 ms.
Rows: tick, position [1], velocity [1/s], acceleration [1/s^2].
"""
MOTION_COLUMNS = """
The pseudo-differentiator 30 s/(s + 30) on a motion, a row for each tick of 10 ms.
Rows: input [rad], output [rad/s].
"""

T = 0.01


def trajectory_filter():
    """Returns the step response of 1/(0.2 s + 1)^2 with its first two derivatives, at selected ticks."""
    tf = 0.2
    # States: position and velocity; outputs: position, velocity, acceleration.
    a = [[0, 1], [-1 / tf**2, -2 / tf]]
    b = [[0], [1 / tf**2]]
    c = [[1, 0], [0, 1], a[1]]
    d = [[0], [0], b[1]]
    ticks = [1, 2, 5, 10, 20, 40, 80, 160, 320]
    times = np.arange(max(ticks) + 1) * T
    _, y, _ = signal.lsim((a, b, c, d), np.ones_like(times), times, interp=False)
    rows = [f"    ({k}, {float(y[k][0])!r}, {float(y[k][1])!r}, {float(y[k][2])!r})," for k in ticks]
    return "&[\n" + "\n".join(rows) + "\n]\n"


def pseudo_differentiator():
    """30 s/(s + 30), first-order hold (ramp-invariant), on a smooth motion with a stop."""
    w = 30.0
    num, den, _ = signal.cont2discrete(([w, 0], [1, w]), T, method="foh")
    n = np.arange(80)
    motion = np.float32(0.3 * np.sin(7 * n * T) * (n < 50) + 0.3 * np.sin(7 * 50 * T) * (n >= 50))
    out = signal.lfilter(num.ravel(), den, motion.astype(float))
    rows = [f"    ({np.format_float_positional(u, trim='0')}, {float(y)!r})," for u, y in zip(motion, out)]
    return "&[\n" + "\n".join(rows) + "\n]\n"


if __name__ == "__main__":
    write("trajectory_filter.in", __file__, STEP_COLUMNS, trajectory_filter())
    write("pseudo_differentiator.in", __file__, MOTION_COLUMNS, pseudo_differentiator())
