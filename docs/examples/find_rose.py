#!/usr/bin/env python3
"""A vision for `tesaki approach` with OpenCV: find_rose.py CAMERA'S NUMBER or FILE. Needs opencv-python."""
import json, socket, sys, time
from camera import SIZE, cv2, pictures  # beside this file

DELAY = 0.05  # s, from the exposure to here
link = socket.create_connection(("localhost", 7800))
for number, (taken, grey) in enumerate(pictures(sys.argv[1])):
    found = cv2.HoughCircles(grey, cv2.HOUGH_GRADIENT_ALT, 1.5, 20, param1=300, param2=0.8, minRadius=12)
    largest = None if found is None else max(found[0].tolist(), key=lambda circle: circle[2])
    circle = largest and {"center": largest[:2], "radius": largest[2], "confidence": 0.7}
    line = {"picture": number, "age": time.monotonic() - taken + DELAY, "size": SIZE, "circle": circle}
    link.sendall((json.dumps(line) + "\n").encode())
