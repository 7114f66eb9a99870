#!/usr/bin/env python3
"""The network that finds the rim along a ray (shared/src/vision/offset.rs), fitted to rendered pictures.

    rim_offset.py check DOORS SET...   fits, and says whether the weights in offset_weights.rs stand
    rim_offset.py fit DOORS SET...     writes what it fits into offset_weights.rs
    rim_offset.py errors FILE...       median errors of the circles before the network refines them, and after
    rim_offset.py data DOORS SET...    writes data/rim_offset.in, with the weights in offset_weights.rs

The files are what the example `circle_evidence` of host-sim prints for `rays`: DOORS of machines of `knob-find`, SET of
sets of `find_circle.py`. How to make them: tests/oracles/README.md.

For each ray the network estimates the distance of the rim from an ellipse, and the logarithm of the scale of its error,
from the contrasts along it and two neighbours, and from the mean and the first harmonic of all rays. The loss is the
error of centre and radius of the ellipse fitted to these estimates, large errors limited, so that errors which rays have
in common count; and, a tenth, the mean of -log of a Laplace density of each ray's error. Weights begin at random, with a
fixed seed; Adam with a rate that falls to 0 finds them.

Needs numpy."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from data_file import write

WEIGHTS = Path(__file__).parents[2] / "shared/src/vision/offset_weights.rs"
# Inputs: of a ray and two neighbours, and the radius; the mean of all rays; their first harmonic.
OF_RAY, OWN = 10, 31
SIZES = (OWN + 2 * OF_RAY, 48, 24, 2)
PARTS = {"FIRST": slice(0, OWN), "MEAN": slice(OWN, OWN + OF_RAY), "ALONG": slice(OWN + OF_RAY, None)}
RAYS, FEWEST = 64, 16
# Ellipses farther from the rim than that began at another edge, larger ones are not refined [px].
FAR, LARGEST = 4.0, 80.0
# Bounds of the logarithm of the scale; prior standard deviation of the flattening.
LOG_SCALE, FLATTENING = (-3.0, 2.0), 0.03
# Weight of a picture of a set; of the error of each ray.
SET_WEIGHT, RAY_WEIGHT = 8, 0.1
EPOCHS, BATCH, RATE, DECAY = 30, 32, 3e-3, 1e-6
# Below these errors the loss is quadratic, of a picture and of a ray; beyond this, that of a picture flattens [px].
SMOOTH, RAY_SMOOTH, LIMIT = 0.1, 0.05, 1.5
# Weights stand if their loss is at most this much above that of the fit [px].
STANDS = 0.01
# Rays in data/rim_offset.in.
SHOWN = 12
COLUMNS = """
Rays as if they were all of their ring, in double precision: direction, inputs of the network, the distance of the rim
[px], its weight.
"""


class Pictures:
    """Pictures with up to 64 rays each, in arrays of equal length: inputs, offsets of the rim, what an offset of the
    ellipse adds along each ray, whether the ray is there; error of radius and centre, variance of the flattening,
    weight."""

    def __init__(self, files):
        parts = [self.read(file, 1 if file == files[0] else SET_WEIGHT) for file in files]
        self.parts = [np.concatenate(part).astype(np.float32) for part in zip(*parts)]

    @staticmethod
    def read(file, weight):
        rows = np.fromfile(file, "<f4").reshape(-1, 10 + OWN).astype(float)
        a, b, angle, dx, dy, u, v, reach = rows[:, 2:10].T
        flattening = (a * a - b * b) / (a * a + b * b)
        p, q = -flattening * np.cos(2 * angle), -flattening * np.sin(2 * angle)
        # Where the ray from (0, 0) meets w² + p (w_x² - w_y²) + 2 q w_x w_y = a b √(1 - p² - q²), w = distance · (u, v) - (dx, dy).
        form = lambda x, y, s, t: x * s + y * t + p * (x * s - y * t) + q * (x * t + y * s)
        square, cross, rest = form(u, v, u, v), -form(u, v, dx, dy), form(dx, dy, dx, dy) - a * b * np.sqrt(1 - p * p - q * q)
        offsets = (np.sqrt(np.maximum(cross * cross - square * rest, 0)) - cross) / square - reach
        terms = np.stack([np.ones_like(u), u, v, u * u - v * v, 2 * u * v], 1)
        pictures = []
        starts = np.flatnonzero(np.any(np.diff(rows[:, :2], axis=0), 1)) + 1
        for rays in np.split(np.arange(len(rows)), starts):
            a, b, _, dx, dy = rows[rays[0], 2:7]
            radius, rim = np.exp(np.mean(np.log(reach[rays]))), np.sqrt(a * b)
            if rim <= LARGEST and len(rays) >= FEWEST and max(np.hypot(dx, dy), abs(rim - radius)) <= FAR:
                pad = lambda values: np.pad(values, [(0, RAYS - len(rays))] + [(0, 0)] * (values.ndim - 1))
                pictures.append((pad(with_context(rows[rays, 10:], terms[rays, 1:3])), pad(offsets[rays]), pad(terms[rays]),
                                 pad(np.ones(len(rays))), (rim - radius, dx, dy), (radius * FLATTENING / 2) ** 2, weight))
        return [np.array(part) for part in zip(*pictures)]

    def __getitem__(self, chosen):
        return [part[chosen] for part in self.parts]

    def __len__(self):
        return len(self.parts[0])


def with_context(inputs, directions):
    """Adds the mean of all rays to the inputs of each, and their first harmonic in its direction."""
    profiles = inputs[:, :OF_RAY]
    mean = np.broadcast_to(profiles.mean(0), profiles.shape)
    return np.hstack([inputs, mean, directions @ (directions.T @ profiles / len(profiles))])


def outputs(network, inputs):
    """Returns the values of all layers."""
    values = [inputs]
    for weights, biases in network:
        inputs = (values[-1] if len(values) == 1 else np.maximum(values[-1], 0)) @ weights + biases
        values.append(inputs)
    return values


def loss(network, pictures):
    """Returns the loss, the errors of radius and centre [px], and the gradient of the loss."""
    inputs, offsets, terms, there, truth, variance, share = pictures
    share = share / np.mean(share) / len(share)
    values = outputs(network, inputs.reshape(-1, inputs.shape[-1]))
    offset, log_scale = np.moveaxis(values[-1].reshape(*there.shape, 2), -1, 0)
    inside = (log_scale > LOG_SCALE[0]) & (log_scale < LOG_SCALE[1])
    log_scale = np.clip(log_scale, *LOG_SCALE)
    weight = np.exp(-2 * log_scale) * there
    weighted = terms * weight[..., None]
    matrix = np.swapaxes(weighted, 1, 2) @ terms + 1e-3 * np.eye(5, dtype=np.float32)
    matrix[:, [3, 4], [3, 4]] += 1 / variance[:, None]
    found = np.linalg.solve(matrix, np.swapaxes(weighted, 1, 2) @ offset[..., None])[..., 0]
    errors = found[:, :3] - truth
    sizes = np.sqrt(np.stack([errors[:, 0] ** 2, errors[:, 1] ** 2 + errors[:, 2] ** 2], 1) + SMOOTH**2)
    total = LIMIT * np.sum(share * np.arctan(sizes / LIMIT).sum(1))
    # How the loss changes with what is found, and that with offsets and weights of the rays.
    slope = np.zeros_like(found)
    slope[:, :3] = share[:, None] * errors * (1 / sizes / (1 + (sizes / LIMIT) ** 2))[:, [0, 1, 1]]
    along = (terms @ np.linalg.solve(matrix, slope[..., None]))[..., 0]
    by_offset = weight * along
    by_scale = -2 * weight * along * (offset - (terms @ found[..., None])[..., 0])
    # The rays by themselves.
    share = RAY_WEIGHT * share[:, None] * len(share) * there / there.sum()
    error, inverse = np.clip(offsets, -FAR, FAR) - offset, np.exp(-log_scale)
    total += np.sum(share * (np.abs(error) * inverse + log_scale))
    by_offset -= share * np.clip(error / RAY_SMOOTH, -1, 1) * inverse
    by_scale += share * (1 - np.abs(error) * inverse)
    slope = np.stack([by_offset, by_scale * inside], -1).reshape(-1, 2).astype(np.float32)
    slopes = []
    for index in reversed(range(len(network))):
        before = values[index] if index == 0 else np.maximum(values[index], 0)
        weights, _ = network[index]
        slopes.insert(0, (before.T @ slope + DECAY * weights, slope.sum(0)))
        slope = (slope @ weights.T) * (values[index] > 0)
    return total, errors, slopes


def fit(pictures):
    """Adam (Kingma and Ba 2015) on inputs with mean 0 and deviation 1."""
    rng = np.random.default_rng(0)
    inputs, there = pictures.parts[0], pictures.parts[3] > 0
    mean, deviation = inputs[there].mean(0), inputs[there].std(0) + 1e-6
    network = [(rng.normal(0, 1 / np.sqrt(rows), (rows, columns)).astype(np.float32), np.zeros(columns, np.float32))
               for rows, columns in zip(SIZES, SIZES[1:])]
    first, second = ([tuple(map(np.zeros_like, layer)) for layer in network] for _ in range(2))
    batches = len(pictures) // BATCH
    for epoch in range(EPOCHS):
        order = rng.permutation(len(pictures))
        for batch in range(batches):
            part = pictures[order[batch * BATCH:(batch + 1) * BATCH]]
            part[0] = (part[0] - mean) / deviation
            step = epoch * batches + batch + 1
            rate = 0.5 * RATE * (1 + np.cos(np.pi * step / (EPOCHS * batches)))
            for layer, one, two, slope in zip(network, first, second, loss(network, part)[2]):
                for value, one, two, slope in zip(layer, one, two, slope):
                    one += 0.1 * (slope - one)
                    two += 0.001 * (slope * slope - two)
                    value -= rate * (one / (1 - 0.9**step)) / (np.sqrt(two / (1 - 0.999**step)) + 1e-8)
    network = [(weights.astype(float), biases.astype(float)) for weights, biases in network]
    weights, biases = network[0]
    weights = weights / deviation[:, None]
    return [(weights, biases - mean @ weights), *network[1:]]


def evaluate(network, pictures):
    """Returns the loss, and the errors of radius and centre [px], of all pictures."""
    chosen = [slice(start, start + 1000) for start in range(0, len(pictures), 1000)]
    parts = [(loss(network, pictures[part]), pictures[part][-1].sum()) for part in chosen]
    total = np.average([part[0] for part, _ in parts], weights=[share for _, share in parts])
    return total, np.concatenate([part[1] for part, _ in parts])


def put(network):
    """Writes the weights in the form of rustfmt."""
    numbers = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    text = WEIGHTS.read_text()
    text = text[:text.index("pub(super)")]
    (first, _), (deep, _), (last, _) = network
    for name, weights in [*((name, first[part]) for name, part in PARTS.items()), ("DEEP", deep), ("LAST", last)]:
        rows = ", ".join(map(numbers, weights.T))
        text += f"pub(super) const {name}: [[f32; {len(weights)}]; {weights.shape[1]}] = [{rows}];\n"
    sizes = ", ".join(f"[f32; {size}]" for size in SIZES[1:])
    text += f"pub(super) const BIASES: ({sizes}) = ({', '.join(numbers(biases) for _, biases in network)});\n"
    WEIGHTS.write_text(text)
    subprocess.run(["rustfmt", "--edition", "2024", WEIGHTS], check=True)


def written():
    text = WEIGHTS.read_text()
    parts = [np.array(re.findall(r"-?\d+\.\d+", part), float) for part in text.split("pub(super)")[1:]]
    first = np.vstack([part.reshape(SIZES[1], -1).T for part in parts[:3]])
    deep, last = (part.reshape(size, -1).T for part, size in zip(parts[3:5], SIZES[2:]))
    return list(zip((first, deep, last), np.split(parts[5], np.cumsum(SIZES[1:-1]))))


def data(network, file):
    rows = np.fromfile(file, "<f4").reshape(-1, 10 + OWN)
    rows = rows[::len(rows) // SHOWN][:SHOWN].astype(float)
    number = lambda value: np.format_float_positional(np.float32(value), trim="0")
    numbers = lambda values: f"[{', '.join(map(number, values))}]"
    text = "&[\n"
    for row, inputs in zip(rows, with_context(rows[:, 10:], rows[:, 7:9])):
        offset, log_scale = outputs(network, inputs)[-1]
        weight = np.exp(-2 * np.clip(log_scale, *LOG_SCALE))
        text += f"({numbers(row[7:9])}, {numbers(row[10:])}, {number(offset)}, {number(weight)}),\n"
    write("rim_offset.in", __file__, COLUMNS, text + "]\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["errors", *files] if files:
            for file in files:
                pictures = Pictures([file])
                for what, errors in ("before", pictures.parts[4]), ("after", evaluate(written(), pictures)[1]):
                    radius, centre = np.median(np.abs(errors[:, 0])), np.median(np.hypot(*errors[:, 1:].T))
                    print(f"{file}: {len(pictures)} pictures, {what}: centre {centre:.2f} px, radius {radius:.2f} px")
        case ["data", doors, *_]:
            data(written(), doors)
        case ["check" | "fit" as command, *files] if len(files) > 1:
            pictures = Pictures(files)
            fitted = fit(pictures)
            least, errors = evaluate(fitted, pictures)
            print(f"{len(pictures)} pictures; median error of the centre {np.median(np.hypot(*errors[:, 1:].T)):.3f} px, of "
                  f"the radius {np.median(np.abs(errors[:, 0])):.3f} px; loss {least:.4f} px", flush=True)
            if command == "fit":
                put(fitted)
            else:
                excess = evaluate(written(), pictures)[0] - least
                print(f"The loss of the weights in offset_weights.rs is higher by {excess:.4f} px.")
                if excess > STANDS:
                    sys.exit("They do not stand: fit again.")
        case _:
            sys.exit(__doc__)
