#!/usr/bin/env python3
"""Images of circles under a pinhole camera: points by OpenCV's projectPoints, ellipses by its fitEllipse.

Needs numpy and opencv-python-headless.
"""

import cv2
import numpy as np

from data_file import write

COLUMNS = """
Camera: 256 x 240 px, focal length 140 px, principal point (127.5, 119.5).
Rows: pose of the camera frame in the door frame (position [m], quaternion x y z w); circle about z (height z [m],
radius [m]); images of its points at 0, 45, ... 315 degrees from x to y [px]; ellipse through 720 of them:
centre [px], larger and smaller semi-axis [px].
"""

INTRINSIC = np.array([[140.0, 0, 127.5], [0, 140.0, 119.5], [0, 0, 1]])


def quaternion(rotation):
    vector = cv2.Rodrigues(rotation)[0].ravel()
    angle = np.linalg.norm(vector)
    return np.append(vector / angle * np.sin(angle / 2), np.cos(angle / 2))


def row(random, distance):
    """Returns a camera 50 mm above the axis, tilted by 10 degrees and by a few more about every axis."""
    tilt = np.radians(10)
    mount = np.array([[0, -np.cos(tilt), -np.sin(tilt)], [1, 0, 0], [0, -np.sin(tilt), np.cos(tilt)]])
    rotation = cv2.Rodrigues(random.uniform(-0.15, 0.15, 3))[0] @ mount
    position = np.array([0.05, 0, -distance]) + random.uniform(-0.03, 0.03, 3)
    height, radius = -random.uniform(0, 0.06), random.uniform(0.02, 0.045)

    def project(angles):
        points = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full_like(angles, height)], axis=1)
        to_camera = rotation.T
        image, _ = cv2.projectPoints(points, cv2.Rodrigues(to_camera)[0], -to_camera @ position, INTRINSIC, None)
        return image.reshape(-1, 2)

    points = project(np.radians(np.arange(0, 360, 45.0)))
    dense = project(np.linspace(0, 2 * np.pi, 720, endpoint=False))
    center, axes, _ = cv2.fitEllipse(dense.astype(np.float32))
    axes = sorted((axis / 2 for axis in axes), reverse=True)
    numbers = lambda values: "[" + ", ".join(f"{value:.9f}" for value in values) + "]"
    image = "[" + ", ".join(numbers(point) for point in points) + "]"
    return (f"({numbers(position)}, {numbers(quaternion(rotation))}, {height:.9f}, {radius:.9f}, {image}, "
            f"{numbers(center)}, {numbers(axes)}),\n")


def main():
    random = np.random.default_rng(5)
    rows = [row(random, distance) for distance in (0.15, 0.2, 0.25, 0.3, 0.35, 0.4) for _ in range(4)]
    write("camera.in", __file__, COLUMNS, "&[\n" + "".join(rows) + "]\n")


main()
