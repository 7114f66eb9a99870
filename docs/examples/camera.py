#!/usr/bin/env python3
"""Pictures of a camera for `tesaki look`, as PGM on standard output: camera.py NUMBER or FILE. Needs opencv-python."""
import signal, sys
try:
    import cv2
except ImportError:
    sys.exit("camera.py needs OpenCV: pip install opencv-python")

SIZE = (256, 240)  # px, as the camera was calibrated
signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends with its reader
camera = cv2.VideoCapture(int(sys.argv[1]) if sys.argv[1].isdigit() else sys.argv[1])
while camera.grab():
    grey = cv2.cvtColor(cv2.resize(camera.retrieve()[1], SIZE), cv2.COLOR_BGR2GRAY)
    header = "P5\n%d %d\n255\n" % SIZE  # with "# age %f\n" before the size, look needs no --delay
    sys.stdout.buffer.write(header.encode() + grey.tobytes())
    sys.stdout.buffer.flush()
