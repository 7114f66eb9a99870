#!/usr/bin/env python3
"""The weights of the circle finder's choice (shared/src/vision/judge.rs), fitted to rendered pictures.

    circle_choice.py check DOORS.csv SET.csv...   fits, and says whether the tables of judge.rs stand
    circle_choice.py fit DOORS.csv SET.csv...     writes what it fits into judge.rs
    circle_choice.py data DOORS.csv SET.csv...    writes data/circle_choice.in, with the tables of judge.rs

The files are what the example `circle_evidence` of host-sim prints: DOORS.csv of machines of `knob-find`, with the axis
of the knob, SET.csv of sets of `find_circle.py set`, without it. How to make them: tests/oracles/README.md.

A picture shows the rose at one of its candidates, or at none; their probabilities, exp(log odds) over the sum of them
and 1, are those of the choice. The loss is the mean over the pictures of -log of the probability of the right
candidates, or of none if none is right, plus a normal prior of the weights. A right candidate counts the more, the
nearer it is. Pictures without candidates say nothing.

The candidates that are judged at the end were chosen by the weights. So the tables were fitted again and again, each
time to the candidates that the tables before chose, until the changes became no smaller: some candidates are as good as
others, and change places. Tables stand if the fit to their own candidates is no better than they are, see STANDS.

Needs numpy and scipy."""

import re
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from data_file import write

JUDGE = Path(__file__).parents[2] / "shared/src/vision/judge.rs"
TABLES = {"ALONE": ("FEATURES", slice(0, 16)), "BEHIND": ("FEATURES", slice(16, 32)), "KNOB": ("KNOB_FEATURES", slice(32, 44))}
# Largest errors of centre and radius of a right circle, after and before the last fit [px].
RIGHT, RIGHT_BEFORE = (3.0, 2.0), (4.0, 3.0)
# A right candidate has the weight 0.2, and up to 1 more if its errors are small compared with these [px].
NEAR = (1.5, 0.8)
# Weight of a picture of a set.
SET_WEIGHT = 5.0
# Strength of the prior, for features in units of their root mean square.
PRIOR = 1e-3
# Tables stand if their loss is at most this much above that of the fit, and no weight of it differs by more.
STANDS = (1e-5, 0.1)
# The best candidate's confidence is the probability of all that are nearer to it than this [px].
SAME = (2.5, 2.0)
# Pictures in data/circle_choice.in: of the doors, two of them without a knob, and of the first set.
SHOWN = [(21, 0), (21, 56), (22, 8), (23, 20), (24, 59)], [(0, 0), (0, 1)]
COLUMNS = """
Pictures, each with its candidates, what the choice has to weigh, and the answer in double precision: index of the
likeliest candidate, confidence; rows of centre x, y and radius [px], features of the circle, features of the end of a
knob before it, logarithm of the odds.
"""


class Candidates:
    """Reads the rows of several files; `picture` numbers their pictures."""

    def __init__(self, files):
        rows, self.keys, picture, count = [], [], [], []
        for file in files:
            part = np.genfromtxt(file, delimiter=",", skip_header=1)
            keys, inverse = np.unique(part[:, :2].astype(int), axis=0, return_inverse=True)
            picture.append(inverse.ravel() + len(self.keys))
            count.append(np.full(len(keys), 1.0 if file == files[0] else SET_WEIGHT))
            self.keys += [(file, *key) for key in keys.tolist()]
            rows.append(part)
        rows = np.vstack(rows)
        self.picture, self.count = np.concatenate(picture), np.concatenate(count)
        center, radius, fine_center, fine_radius = np.abs(np.nan_to_num(rows[:, 2:6], nan=np.inf)).T
        right = (fine_center <= RIGHT[0]) & (fine_radius <= RIGHT[1])
        right &= (center <= RIGHT_BEFORE[0]) & (radius <= RIGHT_BEFORE[1])
        near = np.exp(-0.5 * (center / NEAR[0]) ** 2 - 0.5 * (radius / NEAR[1]) ** 2)
        self.worth = np.where(right, 0.2 + near, 0.0)
        self.circles, self.own, self.knob = rows[:, 6:9], rows[:, 9:25], rows[:, 25:37]
        self.behind = ~np.isnan(self.knob[:, :1])

    def features(self):
        """Returns the columns as in the tables: of circles alone, of those behind a knob, of the knob."""
        own, knob = self.own, np.nan_to_num(self.knob)
        return np.hstack([np.where(self.behind, 0.0, own), np.where(self.behind, own, 0.0), knob])


def log_odds(candidates, weights):
    return candidates.features() @ weights


def loss_of(candidates):
    """Returns the loss as a function of scaled weights, with its gradient, and the scale."""
    features, picture, total = candidates.features(), candidates.picture, candidates.count.sum()
    weight = candidates.count[picture]
    scale = np.sqrt(weight @ features**2 / weight.sum()) + 1e-9
    features /= scale
    pictures = len(candidates.count)
    has_right = np.bincount(picture, candidates.worth, pictures) > 0

    def loss(weights):
        odds = features @ weights
        largest = np.zeros(pictures)
        np.maximum.at(largest, picture, odds)
        each = np.exp(odds - largest[picture])
        none = np.exp(-largest)
        all_of = np.bincount(picture, each, pictures) + none
        right = np.where(has_right, np.bincount(picture, each * candidates.worth, pictures), none)
        right = np.maximum(right, 1e-300)
        value = candidates.count @ (np.log(all_of) - np.log(right)) / total + 0.5 * PRIOR * weights @ weights
        expected = np.where(has_right[picture], each * candidates.worth / right[picture], 0.0)
        slope = ((each / all_of[picture] - expected) * weight) @ features / total + PRIOR * weights
        return value, slope

    return loss, scale


def fit(candidates):
    loss, scale = loss_of(candidates)
    options = {"maxiter": 5000, "maxfun": 10000, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 30}
    found = minimize(loss, np.zeros(len(scale)), jac=True, method="L-BFGS-B", options=options)
    return found.x / scale, lambda weights: loss(weights * scale)[0]


def pattern(name, length):
    return rf"const {name}: \[f32; {length}\] =\s*\[(.*?)\];"


def written():
    """Reads the weights in judge.rs."""
    text = JUDGE.read_text()
    tables = [re.search(pattern(name, length), text, re.S)[1] for name, (length, _) in TABLES.items()]
    return np.array([float(word) for table in tables for word in table.split(",") if word.strip()])


def table(name, length, weights):
    """Formats a table as rustfmt does."""
    numbers = ", ".join(f"{weight:.3f}" for weight in weights)
    if len(numbers) <= 103:
        return f"const {name}: [f32; {length}] =\n    [{numbers}];"
    lines = [""]
    for weight in weights:
        number = f"{weight:.3f},"
        if len(lines[-1]) + len(number) > 105:
            lines.append("")
        lines[-1] += f" {number}" if lines[-1] else f"    {number}"
    return f"const {name}: [f32; {length}] = [\n" + "\n".join(lines) + "\n];"


def put(weights):
    text = JUDGE.read_text()
    for name, (length, part) in TABLES.items():
        text = re.sub(pattern(name, length), table(name, length, weights[part]), text, flags=re.S)
    JUDGE.write_text(text)


def data(candidates, weights, files):
    """Returns a few pictures with the answer that the weights give."""
    shown = [(files[0], *key) for key in SHOWN[0]] + [(files[1], *key) for key in SHOWN[1]]
    number = lambda value: np.format_float_positional(np.float32(value), trim="0")
    numbers = lambda values: ", ".join(map(number, values))
    text = "&[\n"
    for key in shown:
        rows = np.flatnonzero(candidates.picture == candidates.keys.index(key))
        odds = log_odds(candidates, weights)[rows]
        best = int(np.argmax(odds))
        away = candidates.circles[rows] - candidates.circles[rows[best]]
        same = (np.hypot(away[:, 0], away[:, 1]) < SAME[0]) & (np.abs(away[:, 2]) < SAME[1])
        confidence = np.exp(odds[same]).sum() / (np.exp(odds).sum() + 1)
        text += f"({best}, {number(confidence)}, &[\n"
        for row, value in zip(rows, odds):
            knob = f"Some([{numbers(candidates.knob[row])}])" if candidates.behind[row] else "None"
            text += f"([{numbers(candidates.circles[row])}], [{numbers(candidates.own[row])}], {knob}, {number(value)}),\n"
        text += "]),\n"
    write("circle_choice.in", __file__, COLUMNS, text + "]\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["check" | "fit" | "data" as command, *files] if len(files) > 1:
            candidates, tables = Candidates(files), written()
            if command == "data":
                data(candidates, tables, files)
                sys.exit()
            weights, loss = fit(candidates)
            change, excess = np.abs(weights - tables), loss(tables) - loss(weights)
            odds = np.sqrt(np.mean(log_odds(candidates, weights - tables) ** 2))
            print(f"{len(candidates.count)} pictures, {len(candidates.picture)} candidates; loss {loss(weights):.6f}. The tables of "
                  f"judge.rs: loss higher by {excess:.1e}, weights differ by {change.mean():.4f}, at most {change.max():.4f}, "
                  f"odds by a factor of {np.exp(odds):.3f} (root mean square)", flush=True)
            if command == "fit":
                put(weights)
            elif excess > STANDS[0] or change.max() > STANDS[1]:
                sys.exit("They do not stand: fit again.")
        case _:
            sys.exit(__doc__)
