#!/usr/bin/env python3
"""Draws robots/hand3/placement.svg, the three-finger hand at its initial posture, to scale.

The points come from the paper's forward kinematics alone. Before drawing, the tips are compared with those of
the URDF, and the pitch and the centroid of the fingertip triangle with the numbers in robots/hand3/README.md.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

ROBOT = Path(__file__).parent / "../../robots/hand3"
L0, L1, L2, L3 = 37.5, 39.0, 46.0, 51.78  # mm
P01, P02, P03X, P03Z = 40.0, 40.0, 25.0, 20.0
BASE = 6.0
UPRIGHT = np.eye(3)
LYING = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]])  # axis along +x, r along +z
ROOTS = [([0, P01, L0], UPRIGHT), ([0, -P02, L0], UPRIGHT), ([P03X, 0, P03Z], LYING)]
POSTURE = np.radians([[0, 19, 39], [0, 19, 39], [0, 19, 49]])


def finger(i):
    """Returns root, second joint, third joint and tip of a finger in the hand's frame [mm]."""
    q1, q2, q3 = POSTURE[i]
    r = np.cumsum([0, 0, L2 * np.sin(q2), L3 * np.sin(q2 + q3)])
    z = np.cumsum([0, L1, L2 * np.cos(q2), L3 * np.cos(q2 + q3)])
    root, turn = ROOTS[i]
    return np.array(root) + np.column_stack([r * np.cos(q1), r * np.sin(q1), z]) @ turn.T


def rotation(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def tip_of_urdf(i):
    """Returns the same tip by the chain of the URDF's joints [mm]."""
    angles = dict(zip([f"finger{i + 1}_{joint}" for joint in ("swing", "bend", "curl")], POSTURE[i]))
    position, turn = np.zeros(3), np.eye(3)
    for joint in ET.parse(ROBOT / "robot.urdf").findall("joint"):
        if not joint.get("name").startswith(f"finger{i + 1}_"):
            continue
        origin = joint.find("origin")
        position = position + turn @ np.array(origin.get("xyz").split(), float) * 1000
        roll, pitch, yaw = map(float, origin.get("rpy", "0 0 0").split())
        turn = turn @ rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch) @ rotation((1, 0, 0), roll)
        if joint.get("type") == "revolute":
            axis = [float(v) for v in joint.find("axis").get("xyz").split()]
            turn = turn @ rotation(axis, angles[joint.get("name")])
    return position


FINGERS = [finger(i) for i in range(3)]
TIPS = np.array([points[-1] for points in FINGERS])
MIDPOINT, CENTROID = (TIPS[0] + TIPS[1]) / 2, TIPS.mean(axis=0)
LINE = TIPS[2] - MIDPOINT
PITCH = np.arctan2(-LINE[2], LINE[0])  # about +y, as the paper's box

# ---- drawing ----
WIDTH, HEIGHT, SCALE = 1100, 620, 2.6
COLOURS = ["#1f6fb4", "#d9731a", "#2b8a3e"]
INK, GREY, PALM = "#222", "#777", "#d9dce0"
out = []


class View:
    """A view of two axes of the hand; (left, bottom) is the corner of its frame in pixels, `low`, `high` its range."""

    def __init__(self, left, bottom, axes, low, high):
        self.left, self.bottom, self.axes, self.low, self.high = left, bottom, axes, low, high

    def at(self, u, v):
        return self.left + (u - self.low[0]) * SCALE, self.bottom - (v - self.low[1]) * SCALE

    def of(self, point):
        return tuple(np.asarray(point)[list(self.axes)])

    def line(self, a, b, colour=INK, width=1.0, more=""):
        (x1, y1), (x2, y2) = self.at(*a), self.at(*b)
        out.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
            f'stroke-width="{width}" {more}/>'
        )

    def text(self, at, text, dx=0.0, dy=0.0, anchor="middle", colour=INK, size=13, turn=0.0, more=""):
        x, y = self.at(*at)
        spin = f' transform="rotate({turn:.1f} {x:.1f} {y:.1f})"' if turn else ""
        out.append(
            f'<text x="{x + dx:.1f}" y="{y + dy:.1f}" text-anchor="{anchor}" fill="{colour}" font-size="{size}" '
            f"{more}{spin}>{text}</text>"
        )

    def circle(self, at, radius, fill, stroke, width=1.5):
        x, y = self.at(*at)
        out.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{stroke}" stroke-width="{width}"/>'
        )

    def box(self, low, high):
        x, y = self.at(low[0], high[1])
        w, h = (np.array(high) - low) * SCALE
        out.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="{PALM}" stroke="#9aa0a6"/>'
        )

    def dimension(self, a, b, text, offset=(0, 0), **where):
        """Draws an arrow between two points shifted by `offset`, with thin lines back to the points."""
        a, b, offset = np.array(a, float), np.array(b, float), np.array(offset, float)
        if offset.any():
            for p in (a, b):
                self.line(p, p + offset * 1.1, GREY, 0.6)
        both = 'marker-start="url(#dim)" marker-end="url(#dim)"'
        self.line(a + offset, b + offset, INK, 0.9, both)
        self.text((a + b) / 2 + offset, text, **where)

    def angle(self, centre, start, end, radius, text, reach=1.0):
        """Draws an arc from direction `start` to `end` [rad, from the first axis], a dashed line along
        `start`."""
        centre = np.array(centre)
        ray = lambda a, r: centre + r * np.array([np.cos(a), np.sin(a)])
        self.line(centre, ray(start, radius * 1.25), GREY, 1, 'stroke-dasharray="4 3"')
        (x1, y1), (x2, y2) = self.at(*ray(start, radius)), self.at(*ray(end, radius))
        r, sweep = radius * SCALE, int(end < start)
        out.append(
            f'<path d="M{x1:.1f} {y1:.1f} A{r:.1f} {r:.1f} 0 0 {sweep} {x2:.1f} {y2:.1f}" fill="none" stroke="{INK}" '
            'stroke-width="0.9"/>'
        )
        self.text(ray((start + end) / 2, radius * reach), text, dy=4)

    def scales(self, title):
        (u0, v0), (u1, v1) = self.low, self.high
        names = ["xyz"[a] for a in self.axes]
        self.text(((u0 + u1) / 2, v1), title, dy=-14, size=15, more='font-weight="600"')
        for u in range(int(np.ceil(u0 / 10)) * 10, int(u1) + 1, 10):
            size = 2.2 if u % 50 == 0 else 1.2
            self.line((u, v0), (u, v0 - size), GREY)
            if u % 50 == 0:
                self.text((u, v0), u, dy=20, size=12, colour=GREY)
                self.line((u, v0), (u, v1), "#eef0f2")
        for v in range(int(np.ceil(v0 / 10)) * 10, int(v1) + 1, 10):
            size = 2.2 if v % 50 == 0 else 1.2
            self.line((u0, v), (u0 - size, v), GREY)
            if v % 50 == 0:
                self.text((u0, v), str(v).replace("-", "−"), dx=-9, dy=4, anchor="end", size=12, colour=GREY)
                self.line((u0, v), (u1, v), "#eef0f2")
        self.line((u0, v0), (u1, v0), GREY)
        self.line((u0, v0), (u0, v1), GREY)
        self.text(((u0 + u1) / 2, v0), f"{names[0]} [mm]", dy=38, size=12, colour=GREY)
        x, y = self.at(u0, (v0 + v1) / 2)
        out.append(
            f'<text x="{x - 38:.1f}" y="{y:.1f}" text-anchor="middle" fill="{GREY}" font-size="12" '
            f'transform="rotate(-90 {x - 38:.1f} {y:.1f})">{names[1]} [mm]</text>'
        )

    def triangle(self):
        points = " ".join("{:.1f},{:.1f}".format(*self.at(*self.of(tip))) for tip in TIPS)
        out.append(f'<polygon points="{points}" fill="#8e44ad22" stroke="#8e44ad" stroke-width="1.5"/>')
        u, v = self.at(*self.of(CENTROID))
        for d in (-1, 1):
            out.append(
                f'<line x1="{u - 5:.1f}" y1="{v - 5 * d:.1f}" x2="{u + 5:.1f}" y2="{v + 5 * d:.1f}" stroke="#8e44ad" '
                'stroke-width="2"/>'
            )

    def fingers(self, order):
        for i in order:
            points = [self.of(p) for p in FINGERS[i]]
            for a, b, width in zip(points, points[1:], (11, 8, 6)):
                self.line(a, b, COLOURS[i], width, 'stroke-linecap="round" opacity="0.55"')
            for p in points[:-1]:
                self.circle(p, 5, "white", COLOURS[i], 2)
            self.circle(points[-1], 6.5, INK, COLOURS[i], 2)


def side(view):
    view.scales("Side view (seen from −y)")
    view.box((-30, -BASE), (50, 0))
    view.box((-13, 0), (13, L0))
    view.box((5, 0), (25, 20))
    view.triangle()
    view.fingers((1, 0, 2))
    root, second, third, tip = (view.of(p) for p in FINGERS[0])
    view.dimension((0, 0), root, "l0 37.5", (-21, 0), dx=-6, dy=4, anchor="end")
    view.dimension(root, second, "l1 39.0", (-21, 0), dx=-6, dy=4, anchor="end")
    view.dimension((50, -BASE), (50, 0), "base 6.0", (6, 0), dx=8, dy=4, anchor="start")
    q2, q3 = POSTURE[0, 1:]
    view.text((np.array(second) + third) / 2, "l2 46.0", dy=19, turn=np.degrees(q2) - 90)
    view.text((np.array(third) + tip) / 2, "l3 51.78", dy=19, turn=np.degrees(q2 + q3) - 90)
    view.angle(second, np.pi / 2, np.pi / 2 - q2, 30, "19°", 1.14)
    view.angle(third, np.pi / 2 - q2, np.pi / 2 - q2 - q3, 22, "39°", 1.22)
    view.text(tip, "tips 1, 2", dx=12, dy=-8, anchor="start")
    view.text(root, "fingers 1, 2", dx=22, dy=-45, anchor="start", colour=COLOURS[0], more='font-weight="600"')
    root, second, third, tip = (view.of(p) for p in FINGERS[2])
    q2, q3 = POSTURE[2, 1:]
    view.dimension((0, -BASE), (P03X, -BASE), "p03x 25", (0, -9), dy=17)
    view.dimension((31, 0), (31, P03Z), "p03z 20", dx=6, dy=6, anchor="start")
    view.text((np.array(root) + second) / 2, "l1 39.0", dy=-11)
    view.text((np.array(second) + third) / 2, "l2 46.0", dy=-11, turn=-np.degrees(q2))
    view.text((np.array(third) + tip) / 2, "l3 51.78", dy=-11, turn=-np.degrees(q2 + q3))
    view.angle(second, 0, q2, 33, "19°", 1.17)
    view.angle(third, q2, q2 + q3, 20, "49°", 1.25)
    view.text(tip, "tip 3", dx=-14, dy=4, anchor="end")
    view.text(second, "finger 3", dx=10, dy=26, anchor="start", colour=COLOURS[2], more='font-weight="600"')
    middle = view.of(MIDPOINT)
    view.angle(middle, 0, -PITCH, 36, "", 1.1)
    view.text(middle, f"pitch {PITCH:.3f} rad", dx=98, dy=42, anchor="start", colour="#8e44ad")
    view.text(view.of(CENTROID), f"centroid x {CENTROID[0]:.1f}", dx=-12, dy=18, anchor="end", colour="#8e44ad")
    view.line((-6, 152), (-6 - 22, 152 - 22), "#c0392b", 2.5, 'marker-end="url(#arrow)"')
    view.text((-17, 141), "gravity", dx=-6, dy=-12, anchor="end", colour="#c0392b")
    view.text((-28, 130), "9.81 m/s² ·", dx=-36, dy=22, anchor="start", colour="#c0392b", size=12)
    view.text((-28, 130), "(−0.71, 0, −0.71)", dx=-36, dy=38, anchor="start", colour="#c0392b", size=12)
    frame(view)


def top(view):
    view.scales("Top view (seen from +z)")
    view.box((-30, -60), (50, 60))
    view.triangle()
    view.fingers((2, 0, 1))
    for i, name in ((0, "p01 40"), (1, "p02 40")):
        root = view.of(FINGERS[i][0])
        view.dimension((0, 0), root, name, (-20, 0), dx=6, dy=4 if i == 0 else 22, anchor="start")
        view.text(view.of(TIPS[i]), f"tip {i + 1}", dx=12, dy=-6 if i == 0 else 16, anchor="start")
        view.text(root, f"finger {i + 1}", dx=6, dy=-14 if i == 0 else 24, colour=COLOURS[i], more='font-weight="600"')
    view.dimension((0, 0), (P03X, 0), "p03x 25", (0, -13), dy=17)
    view.text(view.of(FINGERS[2][1]), "finger 3", dx=66, dy=26, colour=COLOURS[2], more='font-weight="600"')
    view.text(view.of(TIPS[2]), "tip 3", dx=4, dy=26)
    view.text(view.of(CENTROID), "centroid", dx=-2, dy=-13, colour="#8e44ad")
    frame(view)


def frame(view):
    """Draws the hand's frame, with its two visible axes."""
    names = ["xyz"[a] for a in view.axes]
    for axis, name, (dx, dy) in zip(((14, 0), (0, 14)), names, ((4, 14), (9, 6))):
        view.line((0, 0), axis, INK, 2, 'marker-end="url(#arrow)"')
        view.text(axis, name, dx=dx, dy=dy, more='font-style="italic"')
    view.circle((0, 0), 3, INK, INK)


def main():
    for i, tip in enumerate(TIPS):
        assert np.allclose(tip, tip_of_urdf(i), atol=1e-6), (i + 1, tip, tip_of_urdf(i))
    assert abs(PITCH - 0.759) < 5e-4, PITCH
    assert abs(CENTROID[0] - 81.6) < 0.05 and 80 < CENTROID[0] < 86, CENTROID

    side(View(70, 545, (0, 2), (-45, -28), (145, 162)))
    top(View(655, 488, (0, 1), (-36, -75), (132, 75)))
    marker = (
        '<marker id="{0}" viewBox="-10 -5 10 10" refX="0" markerWidth="{1}" markerHeight="{1}" '
        'orient="auto-start-reverse" markerUnits="userSpaceOnUse"><path d="M0 0 L-10 -3.5 L-10 3.5 Z" '
        'fill="context-stroke"/></marker>'
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        'font-family="Helvetica, Arial, sans-serif">',
        "<title>The three-finger hand at its initial posture</title>",
        "<defs>" + marker.format("dim", 9) + marker.format("arrow", 14) + "</defs>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        *out,
        "</svg>",
    ]
    (ROBOT / "placement.svg").write_text("\n".join(lines) + "\n")
    print(f"pitch {PITCH:.4f} rad, centroid {CENTROID.round(1)} mm")


if __name__ == "__main__":
    main()
