#!/usr/bin/env python3
"""Compares `tesaki retarget` with dex-retargeting 0.5 (Qin et al. 2023) on the Allegro hand: one run, one machine, one
core, the motion of allegro_tips.csv, for which joint angles without error exist. Prints the computing time of a frame
(best of three rounds; of dex-retargeting the CPU time, so that other programs do not count)
and how far the vectors from the thumb's tip to the others are from their targets, by Pinocchio for both.

All have the same targets, scaled alike, and begin at the same posture; none filters (of `tesaki retarget`, whose filter
cannot be off, it is at its widest, 20 Hz, and the limits of speed hold). dex-retargeting gets its targets as

  tips      vectors from palm to thumb and from thumb to the others, as `tesaki retarget` has them
  palm      vectors from the palm to all tips, as in its own configuration of this hand
  position  positions of all tips

    pip install numpy pin dex-retargeting      # the last needs torch
    python3 tests/oracles/peers_retargeting.py [target/release/tesaki]
"""

import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from data_file import DATA
from hand_tips import ROBOTS, THUMB, TIPS, Hand

NAME = "allegro"
ROUNDS = 3
PALM = "palm_link"


def load():
    """Returns the targets of all tips in the palm's frame [m], frame by frame."""
    rows = np.loadtxt(DATA / f"{NAME}_tips.csv", delimiter=",", skiprows=1)
    hand = Hand(NAME)
    thumb = hand.tips(hand.open)[0] + hand.settings["scale"] * (rows[:, 1:4] - THUMB) @ hand.turn.T
    return hand, thumb[:, None, :] + rows[:, 13:25].reshape(-1, 4, 3)


def told(name, hand, targets, angles, seconds):
    """`seconds`: median and 99 %."""
    errors = []
    for target, q in zip(targets, angles):
        tips = hand.tips(q)
        errors.append(np.linalg.norm((tips - tips[0]) - (target - target[0]), axis=1)[1:].max())
    errors = 1e3 * np.sort(errors)
    of = lambda part: errors[int(np.ceil(part * len(errors))) - 1]
    median, most = (1e6 * s for s in seconds)
    print(
        f"{name:24} time {median:8.1f} µs, 99 % {most:8.1f} µs; "
        f"error {of(0.5):7.3f} mm, 95 % {of(0.95):7.3f} mm, largest {errors[-1]:7.3f} mm"
    )


def ours(program, hand, targets):
    with tempfile.TemporaryDirectory() as folder:
        out, best = Path(folder) / "joints.csv", None
        arguments = ["--json", "retarget", "--robot", ROBOTS / NAME, "--in", DATA / f"{NAME}_tips.csv"]
        for _ in range(ROUNDS):
            command = [program, *arguments, "--bandwidth", "20", "--out", out]
            result = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            seconds = result["computing_time"]["median"], result["computing_time"]["percentile_99"]
            best = min(best or seconds, seconds)
        rows = list(csv.DictReader(out.open()))
    angles = [np.array([float(row[joint]) for joint in hand.model.names[1:]]) for row in rows]
    told("tesaki retarget", hand, targets, angles, best)


def theirs(name, hand, targets, configuration, references):
    from dex_retargeting.retargeting_config import RetargetingConfig

    urdf = str((ROBOTS / NAME / "robot.urdf").resolve())
    best = None
    for _ in range(ROUNDS):
        retargeting = RetargetingConfig.from_dict(
            {"urdf_path": urdf, "low_pass_alpha": 1.0, "scaling_factor": hand.settings["scale"], **configuration}
        ).build()
        order = [retargeting.joint_names.index(joint) for joint in hand.model.names[1:]]
        start = np.zeros(len(order))
        start[order] = hand.open
        retargeting.set_qpos(start)
        angles, seconds = [], []
        for reference in references:
            begin = time.thread_time()
            q = retargeting.retarget(reference)
            seconds.append(time.thread_time() - begin)
            angles.append(np.asarray(q, dtype=float)[order])
        seconds.sort()
        quantiles = tuple(seconds[int(np.ceil(part * len(seconds))) - 1] for part in (0.5, 0.99))
        best = min(best or quantiles, quantiles)
    told(name, hand, targets, angles, best)


def main():
    import torch

    torch.set_num_threads(1)
    hand, targets = load()
    tips, scale = TIPS[NAME], hand.settings["scale"]
    ours(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent / "../../target/release/tesaki", hand, targets)
    vector = {"type": "vector", "target_link_human_indices": [[0] * 4, [4, 8, 12, 16]], "target_task_link_names": tips}
    between = targets - targets[:, :1]
    between[:, 0] = targets[:, 0]
    origins = [PALM] + [tips[0]] * 3
    theirs("dex-retargeting tips", hand, targets, vector | {"target_origin_link_names": origins}, between / scale)
    theirs("dex-retargeting palm", hand, targets, vector | {"target_origin_link_names": [PALM] * 4}, targets / scale)
    position = {"type": "position", "target_link_names": tips, "target_link_human_indices": [4, 8, 12, 16]}
    theirs("dex-retargeting position", hand, targets, position, targets)


if __name__ == "__main__":
    main()
