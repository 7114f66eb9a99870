#!/usr/bin/env python3
"""The right hand before a webcam as lines of JSON for `tesaki retarget`. Needs mediapipe and opencv-python, and the
model hand_landmarker.task, which https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker links to.

    hand_landmarks.py hand_landmarker.task > hand.jsonl
    hand_landmarks.py hand_landmarker.task --udp 7500
"""

import argparse
import json
import socket
import time


def line(seconds, result):
    """The line of a frame: the first hand that was found, if any. Landmarks are metres about the hand's centre."""
    hand = None
    if result.hand_world_landmarks:
        hand = [[point.x, point.y, point.z] for point in result.hand_world_landmarks[0]]
    frame = {"time": round(seconds, 4), "landmarks": hand}
    if hand:
        frame["handedness"] = result.handedness[0][0].category_name
    return json.dumps(frame)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--udp", type=int, metavar="PORT")
    parser.add_argument("--camera", type=int, default=0)
    options = parser.parse_args()
    try:
        import cv2
        import mediapipe as mp
        from mediapipe.tasks.python import BaseOptions, vision
    except ImportError:
        raise SystemExit("hand_landmarks.py needs MediaPipe and OpenCV: pip install mediapipe opencv-python")
    settings = vision.HandLandmarkerOptions(base_options=BaseOptions(model_asset_path=options.model),
                                            running_mode=vision.RunningMode.VIDEO, num_hands=1)
    camera, out = cv2.VideoCapture(options.camera), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with vision.HandLandmarker.create_from_options(settings) as landmarker:
        while camera.isOpened():
            good, picture = camera.read()
            seconds = time.monotonic()
            if not good:
                break
            # Not flipped: a mirrored picture shows the other hand.
            image = mp.Image(image_format=mp.ImageFormat.SRGB, data=cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            text = line(seconds, landmarker.detect_for_video(image, int(1000 * seconds)))
            if options.udp:
                out.sendto(text.encode(), ("127.0.0.1", options.udp))
            else:
                print(text, flush=True)


if __name__ == "__main__":
    main()
