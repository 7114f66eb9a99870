#!/usr/bin/env python3
"""The largest normal force of a finger whose joints have torque limits, by brute force in double precision.

Forces with a normal part of 1 are sampled all over the friction cone, and ever more finely around the best
one. Each may grow until a joint is at its limit; the smallest of these factors is the answer. Nothing here
uses the closed form. Every number is rounded to single precision first. Writes data/push.in: block by rows,
normal, friction, torques used, limits, largest normal force, and the force that attains it.
"""

import numpy as np

from data_file import write

COLUMNS = """
Rows: block of the Jacobian by rows [m], normal, friction [1], torques used [N m], limits [N m], largest
normal force [N], the force that attains it [N].
"""



def f32(x):
    return np.asarray(x, dtype=np.float32).astype(float)


def growth(block, used, limits, forces):
    """Returns the factors by which each of the forces may grow until a joint is at its limit."""
    torques = forces @ block
    with np.errstate(divide="ignore"):
        room = np.where(torques > 0, limits - used, -limits - used) / torques
    return np.where(torques == 0, np.inf, room).min(axis=1)


def largest(block, normal, friction, used, limits):
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    center, width = np.zeros(2), 1.0
    best = np.inf, None
    for _ in range(12):
        grid = center + width * np.stack(np.meshgrid(*[np.linspace(-1, 1, 121)] * 2), axis=-1).reshape(-1, 2)
        # Points beyond the cone's edge are moved back to it, so that the edge itself is sampled.
        radius = np.linalg.norm(grid, axis=1, keepdims=True)
        grid = grid / np.maximum(radius, 1.0)
        forces = normal + friction * (grid @ np.stack([first, second]))
        factors = growth(block, used, limits, forces)
        index = int(np.argmin(factors))
        if factors[index] < best[0]:
            best = float(factors[index]), forces[index] * factors[index]
            center = grid[index]
        width /= 3
    return best


def case(rng):
    scale = rng.choice([0.02, 0.1])
    block = f32(rng.uniform(-scale, scale, (3, 3)))
    if rng.random() < 0.2:
        # A joint whose axis passes through the contact.
        block[:, rng.integers(3)] = 0.0
    normal = rng.normal(size=3)
    normal = f32(normal / np.linalg.norm(normal))
    if rng.random() < 0.2:
        # A joint that is loaded only by the tangential part.
        column = rng.integers(3)
        block[:, column] = f32(block[:, column] - normal * (normal @ block[:, column]))
    friction = float(f32(rng.choice([0.0, rng.uniform(0.05, 1.2)], p=[0.1, 0.9])))
    limits = f32(rng.uniform(0.1, 1.0, 3))
    used = f32(limits * rng.uniform(-0.95, 0.95, 3) * rng.choice([0.0, 1.0], p=[0.2, 0.8]))
    return block, normal, friction, used, limits


def number(value):
    return np.format_float_positional(np.float32(value), trim="0")


def array(values):
    return "[" + ", ".join(number(v) for v in np.ravel(values)) + "]"


def main():
    rng = np.random.default_rng(1)
    lines = []
    for _ in range(200):
        block, normal, friction, used, limits = values = case(rng)
        push, force = largest(*values)
        assert np.isfinite(push)
        lines.append(
            f"    ({array(block)}, {array(normal)}, {number(friction)}, {array(used)}, {array(limits)}, "
            f"{number(push)}, {array(force)}),"
        )
    write("push.in", __file__, COLUMNS, "&[\n" + "\n".join(lines) + "\n]\n")


if __name__ == "__main__":
    main()
