#!/usr/bin/env python3
"""Global minima of the weighted position errors of the five-finger hand's fingertips under joint limits, for
arbitrary targets: scipy's bounded least squares from many starts, in double precision.

The geometry is that of robots/hand5/robot.urdf, repeated here independently. Needs numpy and scipy; takes
some minutes.
"""

import numpy as np
from scipy.optimize import least_squares

from data_file import write

COLUMNS = """
Postures: angles of the actuated joints [rad], positions of the tips of thumb, index, middle, ring and little
finger [m].
Frames: targets of the tips [m], weights, least weighted sum of squared errors within the joints' limits [m^2].
"""

FRAMES = 30
STARTS = 25
LIMITS = np.array([
    (-0.3, 1.6), (0.0, 1.1), (-0.35, 0.35), (-0.2, 1.2), (-0.2, 1.4),
    (-0.15, 0.35), (-0.2, 1.6), (0.0, 1.8), (0.0, 1.2), (-0.2, 1.6), (0.0, 1.8), (0.0, 1.2),
    (-0.2, 1.6), (0.0, 1.8), (-0.2, 1.6), (0.0, 1.8)])
BEND = 0.35  # of the last segment of ring and little finger


def about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    return {"x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
            "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])}[axis]


def up(length):
    return np.array([0.0, 0.0, length])


def thumb(q):
    rotation = about("z", -q[0]) @ about("x", -q[1])
    position = np.array([0.010, 0.022, 0.020]) + rotation @ up(0.04622)
    rotation = rotation @ about("y", q[2]) @ about("x", q[3])
    position = position + rotation @ up(0.03157)
    rotation = rotation @ about("x", q[4])
    return position + rotation @ up(0.02734)


def finger(base, spread, bends, lengths, last_bend=0.0):
    rotation, position = about("x", -spread), np.array(base)
    for bend, length in zip(bends, lengths):
        rotation = rotation @ about("y", bend)
        position = position + rotation @ up(length)
    if last_bend:
        position = position + rotation @ about("y", last_bend) @ up(lengths[-1])
    return position


def fingers(q):
    """Returns the tips of the four fingers, for the angles of the joints from the sixth on."""
    spread = q[0]
    return [
        finger([0, 0.025, 0.090], spread, q[1:4], [0.03978, 0.02238, 0.01966]),
        finger([0, 0.004, 0.092], 0.3 * spread, q[4:7], [0.04463, 0.02633, 0.02135]),
        finger([0, -0.016, 0.087], -0.4 * spread, q[7:9], [0.04137, 0.02565, 0.02125], BEND),
        finger([0, -0.034, 0.078], -spread, q[9:11], [0.03274, 0.01811, 0.01969], BEND)]


def tips(q):
    return np.array([thumb(q[:5])] + fingers(q[5:]))


def minimum(targets, weights, rng):
    """Returns the least weighted sum of squares. The thumb shares no joint with the fingers."""
    root = np.sqrt(weights)[:, None]
    total = 0.0
    groups = ((slice(0, 5), slice(0, 1), lambda q: [thumb(q)]), (slice(5, 16), slice(1, 5), fingers))
    for columns, rows, places in groups:
        lower, upper = LIMITS[columns].T

        def residual(q):
            return (root[rows] * (np.array(places(q)) - targets[rows])).ravel()

        runs = (least_squares(residual, rng.uniform(lower, upper), bounds=(lower, upper),
                              xtol=1e-11, ftol=1e-11, gtol=1e-11) for _ in range(STARTS))
        total += 2.0 * min(run.cost for run in runs)
    return total


def main():
    rng = np.random.default_rng(5)
    lines = ["(&["]
    for _ in range(20):
        q = np.round(rng.uniform(*LIMITS.T), 6)
        lines.append(f"    ({q.tolist()}, {np.round(tips(q), 9).tolist()}),")
    lines.append("], &[")
    for frame in range(FRAMES):
        # Displaced tips of different postures: in general not reachable together, some not at all.
        targets = np.array([tips(rng.uniform(*LIMITS.T))[finger] for finger in range(5)])
        targets = np.round(targets + rng.uniform(-1, 1, (5, 3)) * (0.03 if frame % 2 else 0.005), 6)
        weights = np.round(rng.uniform(0.5, 2.0, 5), 3) if frame % 3 else np.ones(5)
        least = minimum(targets, weights, rng)
        lines.append(f"    ({targets.tolist()}, {weights.tolist()}, {least:.9e}),")
    lines.append("])")
    write("hand5_retarget.in", __file__, COLUMNS, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
