#!/usr/bin/env python3
"""The network that finds the rim along a ray (shared/src/vision/offset.rs), fitted to rendered pictures.

    rim_offset.py check DOORS SET...   fits, and says whether the weights in offset_weights.rs stand
    rim_offset.py fit DOORS SET...     writes what it fits into offset_weights.rs
    rim_offset.py data DOORS SET...    writes data/rim_offset.in, with the weights in offset_weights.rs

The files are what the example `circle_evidence` of host-sim prints for `rays`: DOORS of machines of `knob-find`, SET of
sets of `find_circle.py set`. How to make them: tests/oracles/README.md.

From the contrasts along a ray the network estimates the distance of the rim from an ellipse, and the logarithm of the
scale of its error. The loss is the mean of -log of a Laplace density with that scale, so rays on which the rim cannot be
told get a large scale, and a small weight in the fit of the ellipse. Weights begin at random, with a fixed seed; Adam
with a rate that falls to 0 finds them.

Needs numpy."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from data_file import write

WEIGHTS = Path(__file__).parents[2] / "shared/src/vision/offset_weights.rs"
SIZES = (31, 32, 16, 2)
NAMES = ("FIRST", "DEEP", "LAST")
# Offsets beyond these are another edge's [px]; bounds of the logarithm of the scale.
FAR, LOG_SCALE = 4.0, (-3.0, 2.0)
# Weight of a picture of a set.
SET_WEIGHT = 4
EPOCHS, BATCH, RATE, DECAY = 30, 512, 3e-3, 1e-5
# Below this error the loss is quadratic [px].
SMOOTH = 0.05
# Weights stand if their loss is at most this much above that of the fit.
STANDS = 0.03
# Rays in data/rim_offset.in.
SHOWN = 12
COLUMNS = """
Rays, in double precision: inputs of the network, the distance of the rim [px], its weight.
"""


def rays(files):
    """Returns inputs and distances of the rim of all rays, those of the sets several times."""
    inputs, offsets = [], []
    for file in files:
        rows = np.fromfile(file, "<f4").reshape(-1, 10 + SIZES[0]).astype(float)
        a, b, angle, dx, dy, u, v, reach = rows[:, 2:10].T
        flattening = (a * a - b * b) / (a * a + b * b)
        p, q = -flattening * np.cos(2 * angle), -flattening * np.sin(2 * angle)
        # Where the ray from (0, 0) meets w² + p (w_x² - w_y²) + 2 q w_x w_y = a b √(1 - p² - q²), w = distance · (u, v) - (dx, dy).
        form = lambda x, y, s, t: x * s + y * t + p * (x * s - y * t) + q * (x * t + y * s)
        square, cross, rest = form(u, v, u, v), -form(u, v, dx, dy), form(dx, dy, dx, dy) - a * b * np.sqrt(1 - p * p - q * q)
        distance = (np.sqrt(np.maximum(cross * cross - square * rest, 0)) - cross) / square
        times = 1 if file == files[0] else SET_WEIGHT
        inputs += [rows[:, 10:]] * times
        offsets += [np.clip(distance - reach, -FAR, FAR)] * times
    return np.vstack(inputs), np.concatenate(offsets)


def outputs(network, inputs):
    """Returns the values of all layers."""
    values = [inputs]
    for weights, biases in network:
        inputs = (values[-1] if len(values) == 1 else np.maximum(values[-1], 0)) @ weights + biases
        values.append(inputs)
    return values


def loss(network, inputs, offsets):
    offset, log_scale = outputs(network, inputs)[-1].T
    log_scale = np.clip(log_scale, *LOG_SCALE)
    return np.mean(np.abs(offsets - offset) * np.exp(-log_scale) + log_scale)


def slopes(network, inputs, offsets):
    """Returns the gradient of the loss."""
    values = outputs(network, inputs)
    offset, log_scale = values[-1].T
    inside = (log_scale > LOG_SCALE[0]) & (log_scale < LOG_SCALE[1])
    error, inverse = offsets - offset, np.exp(-np.clip(log_scale, *LOG_SCALE))
    slope = np.stack([-np.clip(error / SMOOTH, -1, 1) * inverse, (1 - np.abs(error) * inverse) * inside], 1) / len(offsets)
    found = []
    for index in reversed(range(len(network))):
        before = values[index] if index == 0 else np.maximum(values[index], 0)
        weights, _ = network[index]
        found.insert(0, (before.T @ slope + DECAY * weights, slope.sum(0)))
        slope = (slope @ weights.T) * (values[index] > 0)
    return found


def fit(inputs, offsets):
    """Adam (Kingma and Ba 2015) on inputs with mean 0 and deviation 1."""
    rng = np.random.default_rng(0)
    mean, deviation = inputs.mean(0), inputs.std(0) + 1e-6
    scaled = ((inputs - mean) / deviation).astype(np.float32)
    offsets = offsets.astype(np.float32)
    network = [(rng.normal(0, 1 / np.sqrt(rows), (rows, columns)).astype(np.float32), np.zeros(columns, np.float32))
               for rows, columns in zip(SIZES, SIZES[1:])]
    first, second = ([tuple(map(np.zeros_like, layer)) for layer in network] for _ in range(2))
    batches = len(offsets) // BATCH
    for epoch in range(EPOCHS):
        order = rng.permutation(len(offsets))
        for batch in range(batches):
            part = order[batch * BATCH:(batch + 1) * BATCH]
            step = epoch * batches + batch + 1
            rate = 0.5 * RATE * (1 + np.cos(np.pi * step / (EPOCHS * batches)))
            for layer, one, two, slope in zip(network, first, second, slopes(network, scaled[part], offsets[part])):
                for value, one, two, slope in zip(layer, one, two, slope):
                    one += 0.1 * (slope - one)
                    two += 0.001 * (slope * slope - two)
                    value -= rate * (one / (1 - 0.9**step)) / (np.sqrt(two / (1 - 0.999**step)) + 1e-8)
    network = [(weights.astype(float), biases.astype(float)) for weights, biases in network]
    weights, biases = network[0]
    weights = weights / deviation[:, None]
    return [(weights, biases - mean @ weights), *network[1:]]


def put(network):
    """Writes the weights in the form of rustfmt."""
    numbers = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    text = WEIGHTS.read_text()
    text = text[:text.index("pub(super)")]
    for name, (weights, _) in zip(NAMES, network):
        rows = ", ".join(map(numbers, weights.T))
        text += f"pub(super) const {name}: [[f32; {len(weights)}]; {weights.shape[1]}] = [{rows}];\n"
    sizes = ", ".join(f"[f32; {size}]" for size in SIZES[1:])
    text += f"pub(super) const BIASES: ({sizes}) = ({', '.join(numbers(biases) for _, biases in network)});\n"
    WEIGHTS.write_text(text)
    subprocess.run(["rustfmt", "--edition", "2024", WEIGHTS], check=True)


def written():
    text = WEIGHTS.read_text()
    parts = [re.findall(r"-?\d+\.\d+", part) for part in text.split("pub(super)")[1:]]
    *weights, biases = [np.array(part, float) for part in parts]
    ends = np.cumsum(SIZES[1:])
    return [(values.reshape(columns, rows).T, biases[end - columns:end])
            for values, rows, columns, end in zip(weights, SIZES, SIZES[1:], ends)]


def data(network, inputs):
    number = lambda value: np.format_float_positional(np.float32(value), trim="0")
    text = "&[\n"
    for row in inputs[::len(inputs) // SHOWN][:SHOWN]:
        offset, log_scale = outputs(network, row)[-1]
        weight = np.exp(-2 * np.clip(log_scale, *LOG_SCALE))
        text += f"([{', '.join(map(number, row))}], {number(offset)}, {number(weight)}),\n"
    write("rim_offset.in", __file__, COLUMNS, text + "]\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["check" | "fit" | "data" as command, *files] if len(files) > 1:
            inputs, offsets = rays(files)
            if command == "data":
                data(written(), inputs)
                sys.exit()
            fitted = fit(inputs, offsets)
            error = np.abs(offsets - outputs(fitted, inputs)[-1][:, 0])
            print(f"{len(offsets)} rays; median distance of the rim {np.median(np.abs(offsets)):.3f} px, of its estimate "
                  f"{np.median(error):.3f} px; loss {loss(fitted, inputs, offsets):.4f}", flush=True)
            if command == "fit":
                put(fitted)
            else:
                excess = loss(written(), inputs, offsets) - loss(fitted, inputs, offsets)
                print(f"The loss of the weights in offset_weights.rs is higher by {excess:.4f}.")
                if excess > STANDS:
                    sys.exit("They do not stand: fit again.")
        case _:
            sys.exit(__doc__)
