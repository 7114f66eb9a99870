#!/usr/bin/env python3
"""A vision for `tesaki approach` with OpenCV: find_rose.py CAMERA'S NUMBER or FILE. Needs opencv-python."""
import json, socket, sys, time
try:
    import cv2
except ImportError:
    sys.exit("find_rose.py needs OpenCV: pip install opencv-python")

SIZE = (256, 240)  # px, as the camera was calibrated
DELAY = 0.05  # s, from the exposure to here


def middle(picture):  # of a picture, in grey and with square pixels
    height, width = picture.shape[:2]
    side = min(width // 16, height // 15)
    top, left = (height - 15 * side) // 2, (width - 16 * side) // 2
    part = picture[top:top + 15 * side, left:left + 16 * side]
    return cv2.cvtColor(cv2.resize(part, SIZE, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)


link = socket.create_connection(("localhost", 7800))
camera = cv2.VideoCapture(int(sys.argv[1]) if sys.argv[1].isdigit() else sys.argv[1])
number = 0
while camera.grab():
    taken = time.monotonic() - DELAY
    grey = middle(camera.retrieve()[1])
    found = cv2.HoughCircles(grey, cv2.HOUGH_GRADIENT_ALT, 1.5, 20, param1=300, param2=0.8, minRadius=12)
    largest = None if found is None else max(found[0].tolist(), key=lambda circle: circle[2])
    circle = largest and {"center": largest[:2], "radius": largest[2], "confidence": 0.7}
    line = {"picture": number, "age": time.monotonic() - taken, "size": SIZE, "circle": circle}
    link.sendall((json.dumps(line) + "\n").encode())
    number += 1
