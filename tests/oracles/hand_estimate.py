"""Writes data/hand_estimate.in: what a Kalman filter in double precision makes of a hand's samples, whose transition and noise
come from Van Loan's matrix exponential. Jerk driven by white noise, and a tremor that is an oscillation of 10 Hz which fades with
3 1/s; 240 samples a second with a phase error each, a tenth of them lost, and a gap of 70 ms. Each line: time [us], sample [m], and
place, velocity and acceleration 25 ms after it."""

import numpy as np
from scipy.linalg import expm

from data_file import write

COLUMNS = """
Rows: time [us], sample [m], estimate 25 ms later [position [m], velocity [m/s], acceleration [m/s^2]].
"""

WANDER, TREMOR, NOISE = 30.0, 2e-4, 2e-5
OMEGA, FADES, START = 2 * np.pi * 10, 3.0, [1e-2, 1.0, 100.0]
AHEAD = 0.025

drift = np.zeros((6, 6))
drift[0, 1] = drift[1, 2] = drift[2, 3] = 1
drift[4:, 4:] = [[-FADES, OMEGA], [-OMEGA, -FADES]]
density = np.diag([0, 0, 0, WANDER**2, 2 * FADES * TREMOR**2, 2 * FADES * TREMOR**2])
seen = np.array([1.0, 0, 0, 0, 1, 0])


def passing(time):
    big = np.block([[-drift, density], [np.zeros((6, 6)), drift.T]]) * time
    big = expm(big)
    transition = big[6:, 6:].T
    return transition, transition @ big[:6, 6:]


random = np.random.default_rng(1)
mean, covariance, last, rows = None, None, None, []
for number in range(240):
    time = round((number + 0.2 * random.uniform()) / 240 * 1e6)
    t = time * 1e-6
    place = 0.36 + 0.1 * np.sin(np.pi * t)
    sample = place + 7e-5 * np.sin(2 * np.pi * 9.3 * t + 1) + NOISE * random.normal()
    if 120 <= number < 137 or random.uniform() < 0.1:
        continue
    if mean is None:
        mean = np.array([sample, 0, 0, 0, 0, 0])
        # Nothing was known of the place before: it is the sample less tremor and noise.
        covariance = np.diag([TREMOR**2 + NOISE**2, *START, TREMOR**2, TREMOR**2])
        covariance[0, 4] = covariance[4, 0] = -TREMOR**2
    else:
        transition, noise = passing((time - last) * 1e-6)
        mean, covariance = transition @ mean, transition @ covariance @ transition.T + noise
        gain = covariance @ seen / (seen @ covariance @ seen + NOISE**2)
        mean = mean + gain * (sample - seen @ mean)
        covariance = covariance - np.outer(gain, seen @ covariance)
    last = time
    ahead = passing(AHEAD)[0] @ mean
    rows.append(f"({time}, {sample:.9f}, [{ahead[0]:.8f}, {ahead[1]:.7f}, {ahead[2]:.6f}]),\n")
write("hand_estimate.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")
