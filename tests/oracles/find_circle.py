#!/usr/bin/env python3
"""Images of a door with rose and knob, their true ellipses, and what OpenCV finds in them.

    find_circle.py                     writes data/find_circle.bin and data/find_circle.in
    find_circle.py set N SEED DIR      a set of N images for the example `circle_accuracy`, 256 x 240
    find_circle.py discs N SEED DIR    a set of plain discs, whose rim is their only edge
    find_circle.py covered N SEED DIR  a set of plain discs, each with a round one before it that hides a part of its rim
    find_circle.py opencv DIR          what OpenCV's HOUGH_GRADIENT_ALT finds in such a set

Needs opencv-python-headless and numpy."""

import sys
import time
from functools import partial
from pathlib import Path

try:
    import cv2
    import numpy as np
except ImportError:
    sys.exit("find_circle.py needs OpenCV and NumPy: pip install opencv-python-headless numpy")

from data_file import DATA, write

COLUMNS = """
The images lie one after the other in find_circle.bin, a byte per pixel, row by row. The pixel in the corner has its
centre at (0, 0). OpenCV: HoughCircles with HOUGH_GRADIENT_ALT, largest of the circles whose radius is expected;
zeros where it finds none.
Rows: width, height, expected radius from, to; true centre x, y, radius (root of the product of the semi-axes);
OpenCV's centre x, y, radius [px].
"""
SAMPLES = 3
KNOB_RADIUS, KNOB_LENGTH = 25.0, 60.0


def rotation(rng, tilt):
    """Returns a camera that looks at the door (along -z of the door), slightly rotated."""
    wobble = np.radians(rng.uniform(-3, 3, 3))
    angles = wobble + [np.radians(tilt), 0, 0]
    matrix = cv2.Rodrigues(np.array([np.pi, 0, 0]))[0]
    for axis in np.eye(3):
        matrix = cv2.Rodrigues(axis * (axis @ angles))[0] @ matrix
    return matrix


def texture(rng, x, y):
    """Draws the grain of wood: bent stripes along the door."""
    kind = rng.integers(3)
    if kind == 0:
        return np.zeros_like(x)
    amplitude, pitch = rng.uniform(1, 8), rng.uniform(3, 15)
    phase = x / pitch + rng.uniform(0.5, 2) * np.sin(y / rng.uniform(30, 90) + rng.uniform(0, 6))
    grain = np.sin(2 * np.pi * phase) + 0.5 * np.sin(2 * np.pi * 2.7 * phase + 1)
    return amplitude * grain / 1.5 if kind == 1 else amplitude * 0.5 * grain


def draw(rng, width, height):
    """Returns an image and its true ellipse: x, y, radius, semi-axes [px], the angle of the first one [rad]."""
    while True:
        distance = rng.uniform(170, 480)
        rose, thickness = rng.uniform(35, 45), rng.uniform(2, 8)
        radius = np.exp(rng.uniform(np.log(15), np.log(90 * width / 256)))
        focal = radius * distance / rose
        if focal < 120 * width / 256:
            continue
        above = rng.uniform(30, 90)
        turned = rotation(rng, 10)
        # The rose's centre in the image; the camera's place on the door follows from it.
        spot = np.array([rng.uniform(0.15, 0.85) * width, rng.uniform(0.15, 0.85) * height])
        ray = turned.T @ np.array([(spot[0] - width / 2) / focal, (spot[1] - height / 2) / focal, 1.0])
        camera = np.array([0, 0, thickness]) + ray * (distance / ray[2])
        # Views far from the axis of the knob do not occur.
        if np.hypot(camera[0], camera[1] - above) < 0.35 * distance:
            break
    step = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u = (np.arange(width)[:, None] + step).ravel()
    v = (np.arange(height)[:, None] + step).ravel()
    u, v = np.meshgrid(u, v)
    dirs = np.stack([(u - width / 2) / focal, (v - height / 2) / focal, np.ones_like(u)], -1) @ turned
    # Grey levels, with light from one side.
    door, contrast = rng.uniform(60, 190), rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(15), np.log(90)))
    rose_level = door + contrast
    if not 10 < rose_level < 245:
        rose_level = door - contrast
    face_level = np.clip(rose_level + rng.choice([-1, 1]) * rng.uniform(8, 70), 5, 250)
    side_level = np.clip(rose_level + rng.choice([-1, 1]) * rng.uniform(15, 80), 5, 250)
    slope = rng.uniform(-0.15, 0.15, 2)

    def on_plane(z):
        t = (z - camera[2]) / dirs[..., 2]
        return camera[0] + t * dirs[..., 0], camera[1] + t * dirs[..., 1]

    x, y = on_plane(0)
    grey = door + texture(rng, x, y) + slope[0] * x * 0.3 + slope[1] * y * 0.3
    edge = rng.uniform(48, 70) * rng.choice([-1, 1])
    beyond = (x > edge) if edge > 0 else (x < edge)
    grey[beyond] = rng.uniform(20, 220)
    if rng.random() < 0.5:  # shadow of the rose and knob, soft by the blur
        sx, sy = rng.uniform(-8, 8), rng.uniform(2, 12)
        grey[np.hypot(x - sx, y - sy) < rose] *= rng.uniform(0.75, 0.95)
    # The side of the rose, then its front.
    for z in np.linspace(0, thickness, 6)[:-1]:
        x, y = on_plane(z)
        grey[np.hypot(x, y) < rose] = rose_level * 0.7
    x, y = on_plane(thickness)
    inside = np.hypot(x, y) < rose
    around = np.arctan2(y, x)
    level = rose_level + slope[0] * x + slope[1] * y
    if rng.random() < 0.6:  # radial streaks of brushed metal
        for _ in range(rng.integers(1, 5)):
            at, wide, bright = rng.uniform(-np.pi, np.pi), rng.uniform(0.03, 0.25), rng.uniform(20, 150)
            level = level + bright * np.exp(-(np.angle(np.exp(1j * (around - at))) / wide) ** 2)
    if rng.random() < 0.3:  # a groove
        groove = rng.uniform(0.75, 0.92) * rose
        level = level - rng.uniform(5, 30) * (np.abs(np.hypot(x, y) - groove) < 1)
    grey[inside] = level[inside]
    # The knob's side: intersection with the cylinder.
    a = dirs[..., 0] ** 2 + dirs[..., 1] ** 2
    b = camera[0] * dirs[..., 0] + camera[1] * dirs[..., 1]
    c = camera[0] ** 2 + camera[1] ** 2 - KNOB_RADIUS**2
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    z = camera[2] + t * dirs[..., 2]
    hit = (root > 0) & (z > thickness) & (z < KNOB_LENGTH) & (t > 0)
    normal = np.arctan2(camera[1] + t * dirs[..., 1], camera[0] + t * dirs[..., 0])
    level = side_level * (0.7 + 0.3 * np.cos(normal - rng.uniform(-np.pi, np.pi)))
    if rng.random() < 0.6:
        at, wide = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.3)
        level = level + rng.uniform(30, 150) * np.exp(-(np.angle(np.exp(1j * (normal - at))) / wide) ** 2)
    grey[hit] = level[hit]
    x, y = on_plane(KNOB_LENGTH)
    face = np.hypot(x, y) < KNOB_RADIUS
    level = face_level + slope[0] * x * 2 + slope[1] * y * 2
    grey[face] = level[face]
    if rng.random() < 0.4:  # a bright streak across all
        at, turn, wide = rng.uniform(-30, 30), rng.uniform(0, np.pi), rng.uniform(1, 4)
        away = np.abs(x * np.cos(turn) + y * np.sin(turn) - at)
        near = np.hypot(x, y) < rose
        grey[near] += (rng.uniform(40, 160) * np.exp(-((away / wide) ** 2)))[near]
    image = grey.reshape(height, SAMPLES, width, SAMPLES).mean((1, 3))
    exposure = rng.choice([0.4, 0.7, 1, 1, 1, 1.4, 1.9])
    if abs(min(door * exposure, 255) - min(rose_level * exposure, 255)) < 15:
        exposure = 1
    image = cv2.GaussianBlur(image * exposure, (0, 0), rng.uniform(0.5, 1.5)) + rng.normal(0, rng.uniform(0, 6), image.shape)
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    # Fit the rim's ellipse to many of its points.
    turn = np.linspace(0, 2 * np.pi, 721)[:-1]
    points = np.stack([rose * np.cos(turn), rose * np.sin(turn), np.full_like(turn, thickness)], -1) - camera
    points = points @ turned.T
    points = (points[:, :2] / points[:, 2:]) * focal + [width / 2, height / 2]
    (cx, cy), axes, angle = cv2.fitEllipseDirect(points.astype(np.float32))
    a, b = np.array(axes) / 2
    return image, (cx, cy, np.sqrt(a * b), a, b, np.deg2rad(angle))


def disc(rng, width, height, least, covered=False):
    """Returns an image of an elliptic disc on a ground with a slope, at least that fraction of its rim visible, its true
    ellipse, and a prior of the radius. A cover is round and up to as large as the disc."""
    while True:
        radius, ratio, angle = np.exp(rng.uniform(np.log(12), np.log(80))), rng.uniform(1, 1.15), rng.uniform(0, np.pi)
        a, b = radius * np.sqrt(ratio), radius / np.sqrt(ratio)
        x, y = rng.uniform(0.1, 0.9) * width, rng.uniform(0.1, 0.9) * height
        cover = None
        if covered:
            away, turn = radius * rng.uniform(0.2, 1.2), rng.uniform(0, 2 * np.pi)
            cover = (x + away * np.cos(turn), y + away * np.sin(turn), radius * rng.uniform(0.5, 1.05))
        if visible((x, y, radius), width, height, cover) >= least:
            break
    step = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u, v = np.meshgrid((np.arange(width)[:, None] + step).ravel() - x, (np.arange(height)[:, None] + step).ravel() - y)
    along, across = u * np.cos(angle) + v * np.sin(angle), v * np.cos(angle) - u * np.sin(angle)
    ground, contrast = rng.uniform(20, 235), rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(10), np.log(220)))
    grey = ground + rng.uniform(-0.1, 0.1) * u + rng.uniform(-0.1, 0.1) * v
    grey[(along / a) ** 2 + (across / b) ** 2 < 1] += contrast
    if cover is not None:
        grey[np.hypot(u + x - cover[0], v + y - cover[1]) < cover[2]] = rng.uniform(5, 250)
    image = np.clip(grey, 5, 250).reshape(height, SAMPLES, width, SAMPLES).mean((1, 3))
    blurred = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.1, 3)) + rng.normal(0, rng.uniform(0, 6), image.shape)
    off = rng.uniform(0.85, 1.18)
    truth = (x, y, radius, a, b, angle)
    return np.clip(np.rint(blurred), 0, 255).astype(np.uint8), truth, (radius * off / 1.3, radius * off * 1.3)


def visible(circle, width, height, cover=None):
    """Returns the fraction of the rim of a circle (x, y, radius) that is in an image, and not under another circle."""
    turn = np.linspace(0, 2 * np.pi, 100)
    x, y = circle[0] + circle[2] * np.cos(turn), circle[1] + circle[2] * np.sin(turn)
    seen = (x > 1) & (y > 1) & (x < width - 2) & (y < height - 2)
    if cover is not None:
        seen &= np.hypot(x - cover[0], y - cover[1]) > cover[2]
    return np.mean(seen)


def scene(rng, width, height, least):
    """Returns an image in which at least that fraction of the rim is visible, and a prior of the radius
    within 25 %."""
    while True:
        image, truth = draw(rng, width, height)
        if visible(truth[:3], width, height) >= least:
            break
    off = rng.uniform(0.85, 1.18)
    return image, truth, (truth[2] * off / 1.3, truth[2] * off * 1.3)


def opencv(image, low, high):
    """Finds the largest circle of the expected radius; the parameters were not tuned."""
    found = cv2.HoughCircles(cv2.GaussianBlur(image, (5, 5), 1), cv2.HOUGH_GRADIENT_ALT, 1.5, 4, param1=60, param2=0.5,
                             minRadius=int(low), maxRadius=int(np.ceil(high)))
    if found is None:
        return (0.0, 0.0, 0.0)
    circles = found.reshape(-1, found.shape[-1])
    return tuple(circles[np.argmax(circles[:, 2])][:3])


def make_set(draw_one, least, count, seed, folder):
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    with open(folder / "images.bin", "wb") as file:
        for index in range(count):
            rng = np.random.default_rng([seed, index])
            image, truth, prior = draw_one(rng, 256, 240, least)
            file.write(image.tobytes())
            rows.append(" ".join(f"{value:.4f}" for value in (*prior, *truth)))
    (folder / "truth.txt").write_text("\n".join(rows) + "\n")


def judge(folder):
    rows = np.loadtxt(folder / "truth.txt")
    images = np.fromfile(folder / "images.bin", np.uint8).reshape(-1, 240, 256)
    start = time.perf_counter()
    found = np.array([opencv(image, row[0], row[1]) for image, row in zip(images, rows)])
    each = (time.perf_counter() - start) / len(rows)
    centre = np.hypot(found[:, 0] - rows[:, 2], found[:, 1] - rows[:, 3])
    radius = np.abs(found[:, 2] - rows[:, 4])
    right = (centre < 0.1 * rows[:, 4]) & (radius < 0.05 * rows[:, 4])
    print(f"OpenCV {cv2.__version__}: right {np.mean(right):.4f}, none {np.mean(found[:, 2] == 0):.4f}, centre "
          f"{np.median(centre[right]):.3f} px, radius {np.median(radius[right]):.3f} px, {1e3 * each:.3f} ms")


def data():
    rows, images = [], b""
    for index in range(10):
        image, truth, prior = scene(np.random.default_rng([7, index]), 128, 120, 0.6)
        row = (*image.shape[::-1], *prior, *truth[:3], *opencv(image, *prior))
        rows.append("    (" + ", ".join(f"{value:.3f}" if index > 1 else str(value) for index, value in enumerate(row)) + "),")
        images += image.tobytes()
    (DATA / "find_circle.bin").write_bytes(images)
    write("find_circle.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")


if __name__ == "__main__":
    cv2.setNumThreads(1)
    match sys.argv[1:]:
        case ["set", count, seed, folder]:
            make_set(scene, 0.55, int(count), int(seed), Path(folder))
        case ["discs", count, seed, folder]:
            make_set(disc, 0.4, int(count), int(seed), Path(folder))
        case ["covered", count, seed, folder]:
            make_set(partial(disc, covered=True), 0.4, int(count), int(seed), Path(folder))
        case ["opencv", folder]:
            judge(Path(folder))
        case _:
            data()
