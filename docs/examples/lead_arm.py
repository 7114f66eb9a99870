#!/usr/bin/env python3
"""A hand on a circle, as lines of JSON for `tesaki follow`: on standard output, or lead_arm.py PORT as datagrams."""
import json, math, signal, socket, sys, time

RADIUS, PERIOD, RATE = 0.04, 4.0, 100.0  # m, s, Hz
signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends with its reader
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    now = time.monotonic()
    angle = math.tau * now / PERIOD
    hand = [0.0, RADIUS * math.cos(angle), RADIUS * math.sin(angle)]
    line = json.dumps({"time": now, "position": hand, "quaternion": [0.0, 0.0, 0.0, 1.0]})
    link.sendto(line.encode(), ("127.0.0.1", int(sys.argv[1]))) if sys.argv[1:] else print(line, flush=True)
    time.sleep(1.0 / RATE)
