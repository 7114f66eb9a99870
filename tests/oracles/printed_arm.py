#!/usr/bin/env python3
"""The law of the Arm7 paper as it is printed, along one axis: a mass with the acceleration of step 3 (section 2.1), held for
a period of 10 ms, released from 3 cm or after a hand that moves as in figure 7. Double integrals of a held acceleration are
exact. Reference values for the scenario arm7-paper."""

import numpy as np

from data_file import write

COLUMNS = """
The printed law without friction, M 1.5 kg, K 300 N/m; a row for each damping.
Rows: B [N s/m]; overshoot of a release from 3 cm; largest error at the reversals of a hand that moves by 0.1 m at 0.5 Hz [mm].
"""

T, M, K = 0.01, 1.5, 300.0
AMPLITUDE, FREQUENCY, DURATION = 0.1, 0.5, 6.0
MASTER = 240.0  # Hz, sampling rate of the master


def minimum_jerk(s):
    s = np.clip(s, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def hand(t):
    ramp = 0.5 / FREQUENCY
    return AMPLITUDE * minimum_jerk(t / ramp) * minimum_jerk((DURATION - t) / ramp) * np.sin(2 * np.pi * FREQUENCY * t)


def move(damping, start, setpoint, ticks):
    x, v, positions = start, 0.0, []
    for tick in range(ticks):
        positions.append(x)
        acceleration = -(damping * v + K * (x - setpoint(tick * T))) / M
        x, v = x + T * v + T**2 / 2 * acceleration, v + T * acceleration
    return np.array(positions)


def overshoot(damping):
    # The extreme lies between two ticks; the parabola through them is the motion.
    x = move(damping, 0.03, lambda _: 0.0, 100)
    i = int(np.argmin(x))
    a, b, c = x[i - 1 : i + 2]
    return -(b - (a - c) ** 2 / (8 * (a - 2 * b + c)))


def reversals(damping):
    sampled = lambda t: hand(np.floor(t * MASTER + 1e-9) / MASTER)
    x = move(damping, 0.0, sampled, round(DURATION / T))
    t = np.arange(len(x)) * T
    speed = (hand(t + 1e-6) - hand(t - 1e-6)) / 2e-6
    return np.abs(x - hand(t))[np.abs(speed) < 0.01].max()


if __name__ == "__main__":
    rows = [(b, 1e3 * overshoot(b), 1e3 * reversals(b)) for b in (3.75, 7.5, 15.0, 30.0)]
    write("printed_arm.in", __file__, COLUMNS, "&[\n" + "".join(f"    [{b}, {o:.4f}, {r:.4f}],\n" for b, o, r in rows) + "]\n")
