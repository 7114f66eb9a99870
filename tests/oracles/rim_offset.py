#!/usr/bin/env python3
"""The network that finds the rim along a ray (shared/src/vision/offset.rs), fitted to rendered pictures.

    rim_offset.py check FILE[=WEIGHT]...  fits, and says whether the weights in offset_weights.rs stand
    rim_offset.py fit FILE[=WEIGHT]...    writes what it fits into offset_weights.rs
    rim_offset.py errors FILE...          median errors of the circles before the network refines them, and after
    rim_offset.py data FILE               writes data/rim_offset.in, with the weights in offset_weights.rs

The files are what the example `circle_evidence` of host-sim prints for `rays`, of machines of `knob-find` or of a set of
`find_circle.py`, with the weight of each picture, 1 if none is given. How to make them: tests/oracles/README.md.

For each ray the network estimates the distance of the rim from an ellipse, and the logarithm of the scale of its error,
from the contrasts along it and two neighbours, and from the mean of all rays and their covariance with the direction.
The loss is the error of centre and radius of the ellipse fitted to these estimates, large errors limited, so that errors
which rays have in common count; and, with a smaller weight, the mean of -log of a Laplace density of each ray's error.
Weights begin at random, with a fixed seed; Adam with a rate that falls to 0 finds them. Each time that a picture is
taken, chance says whether it is mirrored.

Needs numpy and scipy."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from data_file import write

WEIGHTS = Path(__file__).parents[2] / "shared/src/vision/offset_weights.rs"
# Inputs: of a ray and two neighbours, and the radius; the mean of all rays; their covariance with the direction.
OF_RAY, OWN = 20, 61
SIZES = (OWN + 2 * OF_RAY, 96, 48, 2)
# The inputs of a ray in the mirror: its neighbours are exchanged.
MIRROR = [*range(OF_RAY), *range(2 * OF_RAY, 3 * OF_RAY), *range(OF_RAY, 2 * OF_RAY), *range(3 * OF_RAY, SIZES[0])]
PARTS = {"FIRST": slice(0, OWN), "MEAN": slice(OWN, OWN + OF_RAY), "ALONG": slice(OWN + OF_RAY, None)}
RAYS, FEWEST = 32, 8
# Ellipses farther from the rim than that began at another edge, larger ones are not refined [px].
FAR, LARGEST = 4.0, 80.0
# Bounds of the logarithm of the scale; prior standard deviation of the change of the flattening.
LOG_SCALE, FLATTENING = (-3.0, 2.0), 0.03
# Weight of the error of each ray.
RAY_WEIGHT = 0.3
EPOCHS, BATCH, RATE, DECAY = 60, 32, 3e-3, 1e-6
# Below these errors the loss is quadratic, of a picture and of a ray; beyond this, that of a picture flattens [px].
SMOOTH, RAY_SMOOTH, LIMIT = 0.1, 0.05, 1.5
# Weights stand if their loss is at most this much above that of the fit [px].
STANDS = 0.01
# A ring is in data/rim_offset.in if at least so many of its rays are hidden, and the ellipse is at least that flat.
HIDDEN, FLAT = 12, 0.1
COLUMNS = """
An ellipse near a rim that the border of the image cuts: its radius [px] and flattening; for each ray its direction, the
inputs of the network, the distance of the rim from the ellipse [px] and its weight, in double precision; the change of
radius and centre that fits these distances [px].
"""


class Pictures:
    """Pictures with up to 32 rays each, in arrays of equal length: inputs, offsets of the rim, derivatives of the ellipse's
    distance along each ray, whether the ray is there; error of radius and centre, weight."""

    def __init__(self, files):
        named = [file.partition("=") for file in files]
        parts = [self.read(file, float(weight or 1)) for file, _, weight in named]
        self.parts = [np.concatenate(part).astype(np.float32) for part in zip(*parts)]

    @staticmethod
    def read(file, weight):
        rows = np.fromfile(file, "<f4").reshape(-1, 10 + OWN).astype(float)
        a, b, angle, dx, dy, u, v, polar_radius = rows[:, 2:10].T
        flattening = (a * a - b * b) / (a * a + b * b)
        p, q = -flattening * np.cos(2 * angle), -flattening * np.sin(2 * angle)
        offsets = meets(np.stack([u, v], 1), (dx, dy), np.sqrt(a * b), p, q) - polar_radius
        pictures = []
        starts = np.flatnonzero(np.any(np.diff(rows[:, :2], axis=0), 1)) + 1
        for rays in np.split(np.arange(len(rows)), starts):
            a, b, _, dx, dy = rows[rays[0], 2:7]
            directions = rows[rays, 7:9]
            (radius, *flattening), rim = ellipse(directions, polar_radius[rays]), np.sqrt(a * b)
            if rim <= LARGEST and len(rays) >= FEWEST and max(np.hypot(dx, dy), abs(rim - radius)) <= FAR:
                pad = lambda values: np.pad(values, [(0, RAYS - len(rays))] + [(0, 0)] * (values.ndim - 1))
                terms = derivatives(directions, polar_radius[rays], radius, *flattening)
                pictures.append((pad(with_context(rows[rays, 10:], directions)), pad(offsets[rays]), pad(terms),
                                 pad(np.ones(len(rays))), (rim - radius, dx, dy), weight))
        return [np.array(part) for part in zip(*pictures)]

    def __getitem__(self, chosen):
        return [part[chosen] for part in self.parts]

    def __len__(self):
        return len(self.parts[0])


def meets(directions, centre, radius, p, q):
    """Returns how far from (0, 0) rays meet w² + p (w_x² - w_y²) + 2 q w_x w_y = radius² √(1 - p² - q²) about a centre."""
    (u, v), (dx, dy) = directions.T, centre
    form = lambda x, y, s, t: x * s + y * t + p * (x * s - y * t) + q * (x * t + y * s)
    square, cross, rest = form(u, v, u, v), -form(u, v, dx, dy), form(dx, dy, dx, dy) - radius**2 * np.sqrt(1 - p * p - q * q)
    return (np.sqrt(np.maximum(cross * cross - square * rest, 0)) - cross) / square


def ellipse(directions, polar_radius):
    """Returns the radius and the flattening of the ellipse that is so far away in these directions."""
    u, v = directions.T
    a, p, q = np.linalg.lstsq(np.stack([np.ones_like(u), u * u - v * v, 2 * u * v], 1), polar_radius**-2, rcond=None)[0]
    p, q = p / a, q / a
    return (a * np.sqrt(1 - p * p - q * q)) ** -0.5, p, q


def derivatives(directions, polar_radius, radius, p, q):
    """Returns those of the distance of an ellipse by its radius, centre and flattening."""
    u, v = directions.T
    form, root = 1 + p * (u * u - v * v) + 2 * q * u * v, 1 - p * p - q * q
    flattening = [-polar_radius / 2 * ((u * u - v * v) / form + p / root), -polar_radius / 2 * (2 * u * v / form + q / root)]
    return np.stack([polar_radius / radius, (u + p * u + q * v) / form, (v - p * v + q * u) / form, *flattening], 1)


def with_context(inputs, directions):
    """Adds the mean of all rays to the inputs of each, and their covariance with the direction, in its direction."""
    profiles = inputs[:, :OF_RAY]
    mean = np.broadcast_to(profiles.mean(0), profiles.shape)
    covariance = directions.T @ (profiles - mean) / len(profiles)
    return np.hstack([inputs, mean, (directions - directions.mean(0)) @ covariance])


def outputs(network, inputs):
    """Returns the values of all layers."""
    values = [inputs]
    for weights, biases in network:
        inputs = (values[-1] if len(values) == 1 else np.maximum(values[-1], 0)) @ weights + biases
        values.append(inputs)
    return values


def loss(network, pictures):
    """Returns the loss, the errors of radius and centre [px], and the gradient of the loss."""
    inputs, offsets, terms, there, truth, share = pictures
    share = share / np.mean(share) / len(share)
    values = outputs(network, inputs.reshape(-1, inputs.shape[-1]))
    offset, log_scale = np.moveaxis(values[-1].reshape(*there.shape, 2), -1, 0)
    inside = (log_scale > LOG_SCALE[0]) & (log_scale < LOG_SCALE[1])
    log_scale = np.clip(log_scale, *LOG_SCALE)
    weight = np.exp(-2 * log_scale) * there
    weighted = terms * weight[..., None]
    matrix = np.swapaxes(weighted, 1, 2) @ terms + 1e-3 * np.eye(5, dtype=np.float32)
    matrix[:, [3, 4], [3, 4]] += 1 / FLATTENING**2
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
            mirrored = rng.random(len(part[0])) < 0.5
            part[0][mirrored] = part[0][mirrored][..., MIRROR]
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


def report(what, network, pictures):
    total, errors = evaluate(network, pictures)
    print(f"{len(pictures)} pictures, weights {what}: median error of the centre {np.median(np.hypot(*errors[:, 1:].T)):.3f} px, "
          f"of the radius {np.median(np.abs(errors[:, 0])):.3f} px; loss {total:.4f} px", flush=True)
    return total


def put(network):
    """Writes the weights in the form of rustfmt."""
    numbers = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    text = WEIGHTS.read_text()
    text = text[:text.index("pub(super)")]
    (first, _), (deep, _), (last, _) = network
    for name, weights in [*((name, first[part]) for name, part in PARTS.items()), ("DEEP", deep), ("LAST", last)]:
        rows = ", ".join(map(numbers, weights.T))
        text += f"pub(super) static {name}: [[f32; {len(weights)}]; {weights.shape[1]}] = [{rows}];\n"
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
    starts = np.flatnonzero(np.any(np.diff(rows[:, :2], axis=0), 1)) + 1
    for rays in np.split(rows, starts):
        directions, polar_radius = rays[:, 7:9].astype(float), rays[:, 9].astype(float)
        radius, p, q = ellipse(directions, polar_radius)
        if len(rays) <= RAYS - HIDDEN and np.hypot(p, q) > FLAT:
            break
    else:
        sys.exit(f"{file} has no ring that flat with {HIDDEN} hidden rays")
    offset, log_scale = outputs(network, with_context(rays[:, 10:].astype(float), directions))[-1].T
    weight = np.exp(-2 * np.clip(log_scale, *LOG_SCALE))

    def residuals(change):
        near = meets(directions, change[1:3], radius + change[0], p + change[3], q + change[4])
        return [*(np.sqrt(weight) * (near - polar_radius - offset)), *(change[3:] / FLATTENING)]

    change = least_squares(residuals, np.zeros(5), xtol=1e-12).x
    number = lambda value: np.format_float_positional(np.float32(value), trim="0")
    numbers = lambda values: f"[{', '.join(map(number, values))}]"
    text = f"({number(radius)}, {numbers([p, q])}, &[\n"
    for ray, offset, weight in zip(rays, offset, weight):
        text += f"({numbers(ray[7:9])}, {numbers(ray[10:])}, {number(offset)}, {number(weight)}),\n"
    write("rim_offset.in", __file__, COLUMNS, f"{text}], {numbers(change[:3])})\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["errors", *files] if files:
            for file in files:
                pictures = Pictures([file])
                seen = pictures.parts[3].sum(1)
                for what, errors in ("before", pictures.parts[4]), ("after", evaluate(written(), pictures)[1]):
                    for rings, chosen in ("pictures", seen > 0), ("half hidden", (seen >= 12) & (seen <= 20)):
                        radius, centre = np.abs(errors[chosen, 0]), np.hypot(*errors[chosen, 1:].T)
                        print(f"{file}: {chosen.sum()} {rings}, {what}: centre {np.median(centre):.2f} px, radius "
                              f"{np.median(radius):.2f} px")
        case ["data", file]:
            data(written(), file)
        case ["check" | "fit" as command, *files] if len(files) > 1:
            pictures = Pictures(files)
            fitted = fit(pictures)
            least = report("fitted", fitted, pictures)
            if command == "fit":
                put(fitted)
            else:
                excess = report("in offset_weights.rs", written(), pictures) - least
                if excess > STANDS:
                    sys.exit("They do not stand: fit again.")
        case _:
            sys.exit(__doc__)
