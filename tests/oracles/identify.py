"""Readings of joints that move back and forth, free and under load, and the least-squares estimates from
them.

The estimate is numpy's lstsq; the standard deviations are cluster-robust (Liang
and Zeger 1986: a motion is a cluster, factor G/(G-1)), with the delta method for the friction. Writes
data/identify.in: the readings, and the numbers that `tesaki_supervisor::identify::fit` must find in them; and
data/identify_free.in: the same of a joint without load, for `fit_free` and `fit_gain`.

    python3 tests/oracles/identify.py
"""

import numpy as np

from data_file import write

COLUMNS = """
Readings; (value, standard deviation) of the gain [1], the Coulomb friction [N m] and the viscous
friction [N m s/rad];
residual [N m]; number of readings that move.
Readings: motion, [torque [N m], load [N m], velocity [rad/s], two weights of the links [N m]].
"""

MOVING = 0.03
GAIN, COULOMB, VISCOUS, SHARES = 1.13, 0.0217, 0.0016, (0.9, 1.15)


def readings():
    random = np.random.default_rng(7)
    rows = []
    for motion in range(24):
        # Every fourth pair of motions is free; the others press with 1, 2, 3 N at 70 mm.
        force = float(motion // 2 % 4)
        way = 1.0 if motion % 2 == 0 else -1.0
        slip = 0.0004 * random.standard_normal()
        for tick in range(20):
            share = (tick + 0.5) / 20
            velocity = way * 0.5 * np.sin(np.pi * share) + 0.002 * random.standard_normal()
            angle = way * (share - 0.5) * 0.3
            load = 0.07 * force * (1 + 0.1 * angle)
            weights = (0.006 * np.sin(0.5 + angle), 0.003 * np.sin(0.9 + 1.3 * angle))
            own = load + COULOMB * np.sign(velocity) + VISCOUS * velocity + np.dot(SHARES, weights)
            torque = own / GAIN + slip + 0.0006 * random.standard_normal()
            rows.append((motion, *(round(float(x), 7) for x in (torque, load, velocity, *weights))))
    return rows


def least_squares(motion, x, y):
    """Returns the solution, its cluster-robust covariance, and the root mean square of the residual."""
    beta, _, rank, _ = np.linalg.lstsq(x, y, rcond=None)
    assert rank == x.shape[1]
    rest = y - x @ beta
    bread = np.linalg.inv(x.T @ x)
    names = np.unique(motion)
    meat = sum(np.outer(s, s) for s in (x[motion == m].T @ rest[motion == m] for m in names))
    covariance = bread @ meat @ bread * len(names) / (len(names) - 1)
    return beta, covariance, float(np.sqrt(np.mean(rest**2)))


def derived(function, beta, covariance):
    """Returns a function of the solution, and its standard deviation."""
    steps = [1e-6 * max(abs(b), 1e-3) for b in beta]
    change = [
        (function(beta + np.eye(len(beta))[i] * h) - function(beta - np.eye(len(beta))[i] * h)) / (2 * h)
        for i, h in enumerate(steps)
    ]
    return float(function(beta)), float(np.sqrt(change @ covariance @ change))


def moving(rows):
    return np.array([row for row in rows if abs(row[3]) > MOVING])


def fit(rows):
    rows = moving(rows)
    motion, y, load, velocity = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3]
    x = np.column_stack([load, np.sign(velocity), velocity, rows[:, 4:]])
    beta, covariance, residual = least_squares(motion, x, y)
    results = [
        derived(function, beta, covariance)
        for function in (lambda b: 1 / b[0], lambda b: b[1] / b[0], lambda b: b[2] / b[0])
    ]
    return results, residual, len(rows)


FREE_COLUMNS = """
Readings of a joint without load; (value, standard deviation) of the Coulomb friction [N m], the viscous friction
[N m s/rad], the offset [N m] and the inertia [kg m^2], in commanded torque; residual [N m];
(value, standard deviation) of the gain [1], if the weight is the load; number of readings that move.
Readings: motion, [torque [N m], acceleration [rad/s^2], velocity [rad/s], weight of the links [N m]].
"""

FREE_GAIN, INERTIA = 0.92, 4e-4


def free_readings():
    """Returns minimum-jerk sweeps of 0.2 rad in 0.8 and 0.4 s, sampled every 10 ms, under a weight of about
    0.4 N m."""
    random = np.random.default_rng(11)
    rows, motion = [], 0
    for time in (0.8, 0.4, 0.4):
        for way in (1.0, -1.0):
            slip = 0.0003 * random.standard_normal()
            ticks = round(time / 0.01)
            for tick in range(ticks):
                s = (tick + 0.5) / ticks
                angle = way * 0.2 * (10 * s**3 - 15 * s**4 + 6 * s**5 - 0.5)
                velocity = way * 0.2 * 30 * s**2 * (1 - s) ** 2 / time
                acceleration = way * 0.2 * 60 * s * (1 - s) * (1 - 2 * s) / time**2
                weight = 0.4 * np.cos(0.3 + angle)
                own = weight + COULOMB * np.sign(velocity) + VISCOUS * velocity + INERTIA * acceleration
                torque = own / FREE_GAIN + slip + 0.0006 * random.standard_normal()
                rows.append((motion, *(round(float(x), 7) for x in (torque, acceleration, velocity, weight))))
            motion += 1
    return rows


def fit_free(rows):
    rows = moving(rows)
    motion, torque, acceleration, velocity, weight = rows.T
    friction = [np.sign(velocity), velocity]
    x = np.column_stack([*friction, np.ones(len(rows)), acceleration])
    beta, covariance, residual = least_squares(motion, x, torque - weight)
    results = [(float(b), float(d)) for b, d in zip(beta, np.sqrt(np.diag(covariance)))]
    beta, covariance, _ = least_squares(motion, np.column_stack([weight, *friction, acceleration]), torque)
    return results, residual, derived(lambda b: 1 / b[0], beta, covariance), len(rows)


def pairs(results):
    return ", ".join(f"({v:.12e}, {d:.12e})" for v, d in results)


def text(rows, *rest):
    lines = ["(", "    &["]
    for row in rows:
        lines.append("        (%d, [%s])," % (row[0], ", ".join(f"{x:.7f}" for x in row[1:])))
    lines.append("    ],")
    lines += [f"    {line}," for line in rest]
    return "\n".join([*lines, ")"]) + "\n"


def main():
    rows = readings()
    results, residual, count = fit(rows)
    write("identify.in", __file__, COLUMNS, text(rows, f"[{pairs(results)}]", f"{residual:.12e}", count))
    print(results, residual, count)
    rows = free_readings()
    results, residual, gain, count = fit_free(rows)
    lines = [f"[{pairs(results)}]", f"{residual:.12e}", pairs([gain]), count]
    write("identify_free.in", __file__, FREE_COLUMNS, text(rows, *lines))
    print(results, residual, gain, count)


if __name__ == "__main__":
    main()
