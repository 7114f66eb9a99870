#!/usr/bin/env python3
"""Counts what OpenCV's HoughCircles finds in rendered pictures of door knobs. First run `cargo sim
render-knob --seed 1-300 --out DIR > DIR/truth.jsonl`, then `peers_circles.py DIR/truth.jsonl`.

Right: centre within 3 px and radius within 2 px of the rose. Needs numpy and opencv-python-headless.
"""

import json
import sys
from collections import Counter

import cv2
import numpy as np

METHODS = {
    "HOUGH_GRADIENT_ALT": dict(method=cv2.HOUGH_GRADIENT_ALT, dp=1.5, minDist=5, param1=120, param2=0.8),
    "HOUGH_GRADIENT": dict(method=cv2.HOUGH_GRADIENT, dp=1, minDist=10, param1=100, param2=20),
}


def judge(circle, rose, knob):
    *center, radius = circle
    off = np.hypot(*np.subtract(center, rose["center"])), abs(radius - rose["radius"])
    if off[0] <= 3 and off[1] <= 2:
        return "right", off
    at_knob = np.hypot(*np.subtract(center, knob["center"])) <= 4 and radius <= knob["radius"] + 2
    within = np.hypot(*np.subtract(center, rose["center"])) <= rose["radius"] / 2 and radius < rose["radius"] - 2
    return ("inner" if at_knob or within else "wrong"), None


def main():
    rows = [json.loads(line) for line in open(sys.argv[1])]
    rows = [row for row in rows if row["rose"] and row["knob"] and row["rose"]["visible"] >= 0.5]
    for name, options in METHODS.items():
        results, errors = Counter(), []
        for row in rows:
            image = cv2.GaussianBlur(cv2.imread(row["file"], cv2.IMREAD_GRAYSCALE), (0, 0), 1.0)
            circles = cv2.HoughCircles(image, minRadius=8, maxRadius=75, **options)
            result, error = ("nothing", None) if circles is None else judge(circles[0][0][:3], row["rose"], row["knob"])
            results[result] += 1
            errors += [error] if error else []
        shares = ", ".join(f"{kind} {100 * count / len(rows):.1f} %" for kind, count in results.most_common())
        center, radius = np.median(errors, axis=0)
        print(f"{name}, {len(rows)} pictures: {shares}; median of the right ones: centre {center:.2f} px, "
              f"radius {radius:.2f} px")


main()
