#!/usr/bin/env python3
"""Pictures of a camera for `tesaki look`, as PGM on standard output: camera.py NUMBER or FILE. Needs opencv-python."""
import signal, sys
try:
    import cv2
except ImportError:
    sys.exit("camera.py needs OpenCV: pip install opencv-python")

SIZE = (256, 240)  # px, as the camera was calibrated


def middle(picture):  # of a picture, in grey and with square pixels
    height, width = picture.shape[:2]
    side = min(width // 16, height // 15)
    top, left = (height - 15 * side) // 2, (width - 16 * side) // 2
    part = picture[top:top + 15 * side, left:left + 16 * side]
    return cv2.cvtColor(cv2.resize(part, SIZE, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)


signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends with its reader
camera = cv2.VideoCapture(int(sys.argv[1]) if sys.argv[1].isdigit() else sys.argv[1])
while camera.grab():
    header = "P5\n%d %d\n255\n" % SIZE  # with "# age %f\n" before the size, look needs no --delay
    sys.stdout.buffer.write(header.encode() + middle(camera.retrieve()[1]).tobytes())
    sys.stdout.buffer.flush()
