"""Readings of a joint that moves to and fro, free and under load, and what least squares makes of them.

The estimate is numpy's lstsq; the standard deviations are cluster-robust (Liang
and Zeger 1986: a motion is a cluster, factor G/(G-1)), with the delta method for the friction. Writes
data/identify.in: the readings, and the numbers that `tesaki_supervisor::identify::fit` must find in them.

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
        # Every fourth pair of motions is free, the others press with 1, 2, 3 N at 70 mm.
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


def fit(rows):
    rows = np.array([row for row in rows if abs(row[3]) > MOVING])
    motion, y, load, velocity = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3]
    x = np.column_stack([load, np.sign(velocity), velocity, rows[:, 4:]])
    beta, _, rank, _ = np.linalg.lstsq(x, y, rcond=None)
    assert rank == x.shape[1]
    rest = y - x @ beta
    bread = np.linalg.inv(x.T @ x)
    names = np.unique(motion)
    meat = sum(np.outer(s, s) for s in (x[motion == m].T @ rest[motion == m] for m in names))
    covariance = bread @ meat @ bread * len(names) / (len(names) - 1)

    def derived(function):
        steps = [1e-6 * max(abs(b), 1e-3) for b in beta]
        change = [
            (function(beta + np.eye(len(beta))[i] * h) - function(beta - np.eye(len(beta))[i] * h)) / (2 * h)
            for i, h in enumerate(steps)
        ]
        return float(function(beta)), float(np.sqrt(change @ covariance @ change))

    results = [derived(lambda b: 1 / b[0]), derived(lambda b: b[1] / b[0]), derived(lambda b: b[2] / b[0])]
    return results, float(np.sqrt(np.mean(rest**2))), len(rows)


def main():
    rows = readings()
    results, residual, count = fit(rows)
    lines = ["("]
    lines.append("    &[")
    for row in rows:
        lines.append("        (%d, [%s])," % (row[0], ", ".join(f"{x:.7f}" for x in row[1:])))
    lines.append("    ],")
    lines.append("    [%s]," % ", ".join(f"({v:.12e}, {d:.12e})" for v, d in results))
    lines.append(f"    {residual:.12e},")
    lines.append(f"    {count},")
    lines.append(")")
    write("identify.in", __file__, COLUMNS, "\n".join(lines) + "\n")
    print(results, residual, count)


if __name__ == "__main__":
    main()
