"""Passes bytes between a program and a board, and loses the answers to a request."""

import socket
import threading
import time

#: The number of `Request::Enable`, see docs/protocol.md.
ENABLE = 10


def decoded(frame):
    """Undoes COBS."""
    data, at = bytearray(), 0
    while at < len(frame):
        length = frame[at]
        data += frame[at + 1 : at + length]
        at += length
        if length < 255 and at < len(frame):
            data.append(0)
    return bytes(data)


def request(frame):
    """The number of a request, after the client and the sequence."""
    data, at = decoded(frame), 0
    for _ in range(2):
        while data[at] & 0x80:
            at += 1
        at += 1
    return data[at]


class Proxy:
    """Listens at `port`. From the next `Enable` on, nothing comes back from the board for `deaf` seconds."""

    def __init__(self, board, folder):
        self.board, self.path = board.port.removeprefix("unix://"), f"{folder}/proxy"
        self.port, self.deaf, self.until = f"unix://{self.path}", 0.0, 0.0
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(self.path)
        self.listener.listen()
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            program, _ = self.listener.accept()
            board = socket.socket(socket.AF_UNIX)
            board.connect(self.board)
            for pass_on in (self.up, self.down):
                threading.Thread(target=pass_on, args=(program, board), daemon=True).start()

    def up(self, program, board):
        rest = b""
        try:
            while data := program.recv(4096):
                *frames, rest = (rest + data).split(b"\0")
                for frame in frames:
                    if self.deaf and frame and request(frame) == ENABLE:
                        self.until, self.deaf = time.monotonic() + self.deaf, 0.0
                    board.sendall(frame + b"\0")
        except OSError:
            pass
        board.close()

    def down(self, program, board):
        try:
            while data := board.recv(4096):
                if time.monotonic() > self.until:
                    program.sendall(data)
        except OSError:
            pass
