#!/usr/bin/env python3
"""Pictures of a camera for `tesaki look`, as PGM on standard output: camera.py NUMBER or FILE. Needs opencv-python."""
import signal, sys, time
try:
    import cv2
except ImportError:
    sys.exit("this program needs OpenCV: pip install opencv-python")

SIZE = (256, 240)  # px, as the camera was calibrated


def pictures(name):
    """Yields the pictures of a camera or film, in grey, with their times: their middle, with square pixels."""
    camera = cv2.VideoCapture(int(name) if name.isdigit() else name)
    while camera.grab():
        taken = time.monotonic()
        picture = camera.retrieve()[1]
        height, width = picture.shape[:2]
        side = min(width // 16, height // 15)
        top, left = (height - 15 * side) // 2, (width - 16 * side) // 2
        part = picture[top:top + 15 * side, left:left + 16 * side]
        yield taken, cv2.cvtColor(cv2.resize(part, SIZE, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ends with its reader
    for _, grey in pictures(sys.argv[1]):
        header = "P5\n%d %d\n255\n" % SIZE  # with "# age %f\n" before the size, look needs no --delay
        sys.stdout.buffer.write(header.encode() + grey.tobytes())
        sys.stdout.buffer.flush()
