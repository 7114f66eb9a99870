#!/usr/bin/env python3
"""The least grip of random grasps from cvxpy, in double precision with second-order cones (Clarabel, ECOS as a second opinion).

For every grasp two problems are solved: by which factor the load can grow before no contact forces hold it, and, when
that is at least 1, the forces of the least sum of squares that hold it. Every number is rounded to single precision
before cvxpy sees it, so that both sides compute the same thing.

    grip.py stored                  writes data/grip.in, which the tests of the crate read
    grip.py grasps COUNT FILE       writes COUNT random grasps with cvxpy's answers to FILE
    grip.py compare FILE            runs the example `grip` of the crate over FILE and compares
"""

import csv
import subprocess
import sys
from multiprocessing import Pool
from pathlib import Path

import cvxpy as cp
import numpy as np

from data_file import write

COLUMNS = """
Grasps: margin [1], least normal force [N], load [N, N m], contacts, half the least sum of squares [N^2]
if the load can be held, whether the load is on the boundary of what can.
Contacts: position [m], normal, friction [1], force limit [N].
"""

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
MAX_CONTACTS = 6
# A load is on the boundary if it differs from the largest one that can be held by less than this fraction.
BOUNDARY = 0.01


def f32(x):
    return np.asarray(x, dtype=np.float32).astype(float)


def unit(v):
    return v / np.linalg.norm(v)


class Grasp:
    """Contacts as rows (position, normal, friction, limit), and the load to be balanced."""

    def __init__(self, margin, least, load, contacts):
        self.margin, self.least, self.load, self.contacts = margin, least, load, contacts

    def arrays(self):
        positions = self.contacts[:, 0:3]
        normals = np.array([unit(n) for n in self.contacts[:, 3:6]])
        friction = self.contacts[:, 6] * (1 - self.margin)
        return positions, normals, friction, self.contacts[:, 7]

    def map(self):
        """Returns the grasp map about the contacts' centroid, with moments divided by their mean distance,
        and the load likewise."""
        positions = self.contacts[:, 0:3]
        center = positions.mean(axis=0)
        arms = positions - center
        length = np.sqrt((arms**2).sum() / len(arms))
        cross = lambda r: np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        G = np.hstack([np.vstack([np.eye(3), cross(r) / length]) for r in arms])
        force, moment = self.load[:3], self.load[3:]
        return G, np.concatenate([force, (moment - np.cross(center, force)) / length])

    def conditions(self, f):
        _, normals, friction, limits = self.arrays()
        conditions = []
        for i, (n, mu, limit) in enumerate(zip(normals, friction, limits)):
            fi = f[3 * i : 3 * i + 3]
            tangents = np.linalg.svd(n[None, :])[2][1:]
            conditions += [cp.SOC(mu * (n @ fi), tangents @ fi), n @ fi <= limit, n @ fi >= self.least]
        return conditions

    def solve(self, solver="CLARABEL"):
        """Returns how far the load is from one that cannot be held, and half the least sum of squares.

        The first is the factor by which the load can grow or, if each contact has a least force, shrink: at
        least 1 when it can be held; `None` when the solver failed.
        """
        G, w = self.map()
        U, s, _ = np.linalg.svd(G)
        rank = int((s > 1e-6 * s[0]).sum())
        beside = U[:, rank:].T @ w
        if np.linalg.norm(beside) > 1e-5 * np.linalg.norm(w):
            return 0.0, None
        U = U[:, :rank]
        f, factor = cp.Variable(G.shape[1]), cp.Variable()
        conditions = [U.T @ G @ f == factor * (U.T @ w), factor <= 1e3, factor >= 0] + self.conditions(f)
        problem = cp.Problem(cp.Maximize(factor), conditions)
        if not solved(problem, solver):
            # With a least force at each contact, even a load of zero may be impossible to hold.
            return (None, None) if problem.status not in ("infeasible", "infeasible_inaccurate") else (0.0, None)
        distance = float(factor.value)
        if self.least > 0 and distance >= 1:
            if not solved(cp.Problem(cp.Minimize(factor), conditions), solver):
                return None, None
            distance = min(distance, 1 / max(float(factor.value), 1e-3))
        if distance < 1:
            return distance, None
        f = cp.Variable(G.shape[1])
        problem = cp.Problem(cp.Minimize(cp.sum_squares(f)), [U.T @ G @ f == U.T @ w] + self.conditions(f))
        if not solved(problem, solver):
            return None, None
        return distance, 0.5 * float(f.value @ f.value)


def solved(problem, solver):
    try:
        problem.solve(solver=solver)
    except cp.SolverError:
        return False
    return problem.status == "optimal"


def random_unit(rng):
    return unit(rng.normal(size=3))


def random_contacts(rng, n):
    size = np.exp(rng.uniform(np.log(0.008), np.log(0.15)))
    offset = rng.uniform(-0.1, 0.1, 3)
    shape = rng.uniform(0.3, 1.0, 3) * size
    kind = rng.choice(["ellipsoid", "opposed", "box", "any", "line"], p=[0.4, 0.3, 0.15, 0.1, 0.05])
    rows = []
    axis = random_unit(rng)
    for i in range(n):
        d = random_unit(rng)
        if kind == "opposed":
            # Fingers on one side, a thumb on the other.
            d = unit((axis if i == n - 1 else -axis) + 0.35 * rng.normal(size=3))
        if kind == "line":
            d = axis * (-1 if i == 0 else 1) * (1 - 0.35 * max(i - 1, 0))
        p = d * shape
        normal = unit(-d / shape)
        if kind == "box":
            face = rng.integers(3)
            side = rng.choice([-1.0, 1.0])
            p = rng.uniform(-1, 1, 3) * shape
            p[face] = side * shape[face]
            normal = np.zeros(3)
            normal[face] = -side
        elif kind == "any":
            p, normal = rng.uniform(-1, 1, 3) * shape, random_unit(rng)
        elif rng.random() < 0.5:
            normal = unit(normal + 0.2 * rng.normal(size=3))
        rows.append(np.concatenate([p + offset, normal, [rng.uniform(0.1, 1.0), np.exp(rng.uniform(0, 4))]]))
    if rng.random() < 0.5:
        for row in rows:
            row[6:8] = rows[0][6:8]
    return f32(np.array(rows)), size


def load_of_forces(rng, contacts):
    """Returns the sum of some forces inside the cones, so that a load in this direction can be held."""
    load = np.zeros(6)
    for c in contacts:
        normal = unit(c[3:6])
        side = np.cross(normal, random_unit(rng))
        push = rng.choice([0.1, 1.0]) * rng.uniform(0.1, 1) * (normal + 0.95 * c[6] * rng.uniform(0, 1) * unit(side))
        load += np.concatenate([push, np.cross(c[0:3], push)])
    return load


def random_grasp(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, MAX_CONTACTS + 1))
    while True:
        contacts, size = random_contacts(rng, n)
        positions = contacts[:, 0:3]
        gaps = [np.linalg.norm(a - b) for i, a in enumerate(positions) for b in positions[:i]]
        if min(gaps) > 0.02 * size:
            break
    center = positions.mean(axis=0)
    force = random_unit(rng) * rng.choice([0.0, 1.0], p=[0.05, 0.95])
    moment = rng.normal(size=3) * size * rng.choice([0.0, 0.1, 0.5], p=[0.3, 0.4, 0.3])
    if not force.any() and not moment.any():
        moment[0] = size
    if n == 2 and rng.random() < 0.85:
        line = unit(positions[1] - positions[0])
        moment -= line * (line @ moment)
    load = np.concatenate([force, moment + np.cross(center, force)])
    if rng.random() < 0.75:
        load = load_of_forces(rng, contacts)
    margin = float(f32(rng.choice([0.0, 0.1, 0.3])))
    least = float(f32(rng.choice([0.0, 0.05], p=[0.8, 0.2])))
    grasp = Grasp(margin, least, load, contacts)
    factor, _ = grasp.solve()
    # Loads from a tenth of the largest to three times the largest, some very near to it.
    if factor is not None and 1e-3 < factor < 1e3:
        ratio = np.exp(rng.uniform(np.log(0.1), np.log(3))) if rng.random() < 0.85 else 1 + rng.uniform(-0.02, 0.02)
        load = load * factor * ratio
    else:
        load = load * np.exp(rng.uniform(-1, 3))
    grasp.load = f32(load)
    factor, objective = grasp.solve()
    if factor is None:
        factor, objective = grasp.solve("ECOS")
    return grasp, factor, objective


def boundary(factor):
    return factor is None or abs(factor - 1) < BOUNDARY


def grasps(count, seed=0):
    with Pool() as pool:
        return pool.map(random_grasp, range(seed, seed + count), chunksize=20)


def write_csv(path, cases):
    with open(path, "w", newline="") as file:
        out = csv.writer(file)
        for index, (grasp, factor, objective) in enumerate(cases):
            row = [index, len(grasp.contacts), grasp.margin, grasp.least, *grasp.load]
            padded = np.zeros((MAX_CONTACTS, 8))
            padded[: len(grasp.contacts)] = grasp.contacts
            row += [repr(np.float32(v).item()) for v in padded.ravel()]
            out.writerow(row + ["" if factor is None else factor, "" if objective is None else objective])


def read_csv(path):
    for row in csv.reader(open(path)):
        n = int(row[1])
        contacts = np.array(row[10:58], dtype=float).reshape(MAX_CONTACTS, 8)[:n]
        grasp = Grasp(float(row[2]), float(row[3]), np.array(row[4:10], dtype=float), contacts)
        yield grasp, *(float(value) if value else None for value in row[58:60])


def violations(grasp, forces):
    """Returns the worst violations relative to the load: balance, cones, normal forces."""
    positions, normals, friction, limits = grasp.arrays()
    G, w = grasp.map()
    load = np.linalg.norm(w)
    balance = np.linalg.norm(G @ forces.ravel() - w)
    along = (normals * forces).sum(axis=1)
    across = np.linalg.norm(forces - along[:, None] * normals, axis=1)
    return np.array([balance, (across - friction * along).max(), max((along - limits).max(), (grasp.least - along).max())]) / load


def separates(grasp, y):
    """Returns how far the certificate's bound is below the load's power, as a fraction of the load's
    power."""
    positions, normals, friction, limits = grasp.arrays()
    center = positions.mean(axis=0)
    v = y[:3] + np.cross(y[3:], positions - center)
    along = (v * normals).sum(axis=1)
    across = np.linalg.norm(v - along[:, None] * normals, axis=1)
    rate = along + friction * across
    most = np.maximum(limits * rate, grasp.least * rate).sum()
    power = y[:3] @ grasp.load[:3] + y[3:] @ (grasp.load[3:] - np.cross(center, grasp.load[:3]))
    return (power - most) / abs(power)


def compare(path):
    command = ["cargo", "run", "--release", "--quiet", "-p", "tesaki", "--example", "grip", "--", str(path)]
    text = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    answers = list(csv.reader(text.splitlines()))
    cases = list(read_csv(path))
    assert len(answers) == len(cases)
    counts, worst, gaps, iterations, margins, odd = {}, np.zeros(3), [], [], [], []
    for index, ((grasp, factor, objective), answer) in enumerate(zip(cases, answers)):
        status, steps = answer[1], int(answer[2])
        iterations.append(steps)
        truth = "unknown" if factor is None else "held" if factor >= 1 else "refused"
        key = (truth, "boundary" if boundary(factor) else "clear", status)
        counts[key] = counts.get(key, 0) + 1
        if truth != status:
            odd.append((index, len(grasp.contacts), factor, status, steps, answer[3] if len(answer) > 3 else ""))
        if status == "held":
            forces = np.array(answer[4:], dtype=float).reshape(-1, 3)
            worst = np.maximum(worst, violations(grasp, forces))
            if objective is not None:
                gap = abs(0.5 * (forces**2).sum() - objective) / objective
                gaps.append((gap, index, factor))
        elif status == "refused":
            margins.append((separates(grasp, np.array(answer[4:], dtype=float)), index, factor))
    for key in sorted(counts):
        print(*key, counts[key])
    agree = sum(count for (truth, _, status), count in counts.items() if truth == status)
    print(f"agree: {agree} of {len(cases)}")
    print("worst violation over the load: balance, cone, normal force:", worst)
    gaps.sort(reverse=True)
    print("largest relative differences of the objective (index, factor):", gaps[:8])
    print("  of those clear of the boundary:", [g for g in gaps if not boundary(g[2])][:5])
    print("weakest certificates (share of the power, index, factor):", sorted(margins)[:5])
    iterations = np.array(iterations)
    print("iterations: median, 99 %, most:", np.median(iterations), np.percentile(iterations, 99), iterations.max())
    for line in odd[:40]:
        print("  differs (index, contacts, factor, status, iterations, violation):", line)


def number(value):
    # The shortest decimal that is this single-precision number.
    return np.format_float_positional(np.float32(value), trim="0")


def array(values):
    return "[" + ", ".join(number(v) for v in np.ravel(values)) + "]"


def stored(count=300):
    lines = []
    for grasp, factor, objective in grasps(count, seed=1_000_000):
        contacts = ", ".join(
            f"({array(c[0:3])}, {array(c[3:6])}, {number(c[6])}, {number(c[7])})" for c in grasp.contacts
        )
        least = "None" if objective is None else f"Some({number(objective)})"
        near = "true" if boundary(factor) else "false"
        lines.append(f"    ({number(grasp.margin)}, {number(grasp.least)}, {array(grasp.load)}, &[{contacts}], {least}, {near}),")
    write("grip.in", __file__, COLUMNS, "&[\n" + "\n".join(lines) + "\n]\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["stored"]:
            stored()
        case ["grasps", count, path]:
            write_csv(path, grasps(int(count)))
        case ["compare", path]:
            compare(path)
        case _:
            sys.exit(__doc__)
