#!/usr/bin/env python3
"""How accurate `tesaki calibrate camera` is on pictures of `cargo sim render-knob`: the table of docs/hand-eye.md.

    hand_eye_accuracy.py [BIN]         BIN: folder of host-sim and tesaki, default target/release

The circles of the calibrated table, of a rose straight before the hand, are compared with those of the true camera
(robots/knob-arm/camera.toml), whose rim is projected point by point; and where the table takes the true circle to be, with
its true place.

Needs opencv-python-headless and numpy."""

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import cv2
import numpy as np

ROBOT = Path(__file__).parents[2] / "robots/knob-arm"
TARGETS = [("disc (`--disc`)", ["--disc"], []), ("rose behind its knob, `--focal 140`", [], ["--focal", "140"]),
           ("rose behind its knob", [], [])]
SEEDS, VIEWS = range(1, 13), 40


def circle(camera, distance, radius):
    """Returns radius and centre of the image of a rose straight before the hand: of the ellipse through its rim."""
    turn, tilt = np.linspace(0, 2 * np.pi, 401)[:-1], camera["tilt"]
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full_like(turn, distance)], 1) - camera["position"]
    ahead, down = [-np.sin(tilt), 0, np.cos(tilt)], [-np.cos(tilt), 0, -np.sin(tilt)]
    image = camera["focal"] * np.stack([rim[:, 1], rim @ down], 1) / (rim @ ahead)[:, None] + camera["principal"]
    centre, axes, _ = cv2.fitEllipseDirect(image.astype(np.float32))
    return np.sqrt(axes[0] * axes[1]) / 2, np.array(centre)


def errors(camera, found, radius):
    """Returns the largest errors of circles [px] and places [m], and of the camera in its standard deviations."""
    rows = np.array(found["rows"])
    rows = rows[np.argsort(rows[:, 0])]
    back = camera["position"][2]
    of_circles, of_places = [], []
    for seen, u, v, distance in rows:
        true, centre = circle(camera, distance, radius)
        of_circles.append(max(np.hypot(*(centre - [u, v])), abs(seen - true)))
        # A radius is nearly inverse to the distance from the camera.
        told = 1 / np.interp(true, rows[:, 0], 1 / (rows[:, 3] - back)) + back
        aside = centre - [np.interp(true, rows[:, 0], rows[:, column]) for column in (1, 2)]
        of_places.append(np.hypot(told - distance, np.hypot(*aside) * (distance - back) / camera["focal"]))
    truth = np.array([*camera["position"], camera["tilt"], 0, 0, camera["focal"]])
    values, deviations = (np.hstack([found[part][name] for name in ("position", "tilt", "pan", "turn", "focal")])
                          for part in ("camera", "deviation"))
    return max(of_circles), max(of_places), np.max(np.abs(values - truth) / deviations)


def main(programs):
    camera = tomllib.loads((ROBOT / "camera.toml").read_text())
    for name, rendered, known in TARGETS:
        results = []
        for seed in SEEDS:
            with tempfile.TemporaryDirectory() as folder:
                views = [programs / "host-sim", "render-knob", *rendered, "--seed", str(seed), "--views", str(VIEWS), "--out", folder]
                picture = subprocess.run(views, capture_output=True, text=True, check=True).stdout.splitlines()[-1]
                radius = json.loads(picture)["rose_radius"]
                calibrate = [programs / "tesaki", "--json", "calibrate", "camera", "--robot", ROBOT, *known, "--rose", str(radius),
                             "--in", f"{folder}/knob-{seed}.csv", "--out", f"{folder}/hand_eye.toml"]
                found = json.loads(subprocess.run(calibrate, capture_output=True, text=True).stdout)
                if "error" not in found:
                    results.append(errors(camera, found, radius))
        pixels, places, deviations = np.max(results, 0)
        print(f"| {name} | {len(results)} of {len(SEEDS)} | {pixels:.1f} px at most | {1e3 * places:.1f} mm at most | "
              f"(camera off by {deviations:.1f} standard deviations at most)", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[2] / "target/release"))
