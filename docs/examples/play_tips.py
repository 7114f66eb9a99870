#!/usr/bin/env python3
"""Plays a table of fingertips as a live source: its frames as lines of JSON, each at its time.

    play_tips.py tips.csv | tesaki retarget --live
"""

import csv
import json
import sys
import time

FINGERS = "thumb", "index", "middle", "ring", "little"


def tip(row, finger):
    values = [row.get(f"{finger}_{axis}") for axis in "xyz"]
    return [float(value) for value in values] if all(values) else None


def main():
    begin = time.monotonic()
    with open(sys.argv[1]) as table:
        for row in csv.DictReader(table):
            seconds = float(row["time"])
            time.sleep(max(0.0, begin + seconds - time.monotonic()))
            frame = {"time": seconds, "tips": {finger: tip(row, finger) for finger in FINGERS}}
            print(json.dumps(frame), flush=True)


try:
    main()
except (BrokenPipeError, KeyboardInterrupt):
    # Who listened has gone: nothing is left to be flushed.
    sys.stdout = None
