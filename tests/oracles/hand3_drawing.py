#!/usr/bin/env python3
"""Draws robots/hand3/placement.svg to scale from the hand's forward kinematics, and checks the numbers that speak for
this reading of the paper's dimensions."""

from pathlib import Path

import numpy as np

OUT = Path(__file__).parent / "../../robots/hand3/placement.svg"
L1, L2, L3 = 39.0, 46.0, 51.78
ROOTS = [np.array([0, 40, 37.5]), np.array([0, -40, 37.5]), np.array([25, 0, 20])]
UPRIGHT = np.eye(3)
FORWARD = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]) @ np.diag([-1, -1, 1])  # axis along +x, r along +z
FRAMES = [UPRIGHT, UPRIGHT, FORWARD]
ANGLES = np.radians([[0, 19, 39], [0, 19, 39], [0, 19, 49]])
COLOURS = ["#0072B2", "#D55E00", "#009E73"]


def finger(index):
    """Root, second joint, third joint, tip [mm]."""
    _, q2, q3 = ANGLES[index]
    points = [(0, 0), (0, L1), (L2 * np.sin(q2), L1 + L2 * np.cos(q2))]
    points.append((points[2][0] + L3 * np.sin(q2 + q3), points[2][1] + L3 * np.cos(q2 + q3)))
    return np.array([ROOTS[index] + FRAMES[index] @ np.array([r, 0, z]) for r, z in points])


FINGERS = [finger(i) for i in range(3)]
TIPS = np.array([f[-1] for f in FINGERS])
LINE = TIPS[2] - (TIPS[0] + TIPS[1]) / 2
PITCH = np.arctan2(-LINE[2], LINE[0])
CENTROID = TIPS.mean(axis=0)


def view(across, title, left, sign):
    """One orthographic view: `across` is the axis drawn to the right, z is up. 2.6 px a mm."""
    scale, top = 2.6, 470

    def place(p):
        return left + sign * scale * p[across], top - scale * p[2]

    out = []
    low, high = (-20, 140) if across == 0 else (-60, 60)
    for mm in range(low, high + 1, 20):
        x = left + sign * scale * mm
        out.append(f'<path d="M{x:.1f} {top}v5" class="axis"/><text x="{x:.1f}" y="{top + 18}" class="tick">{mm}</text>')
    x0 = left + scale * min(sign * low, sign * high) - 14
    for mm in range(0, 161, 20):
        y = top - scale * mm
        out.append(f'<path d="M{x0:.1f} {y:.1f}h-5" class="axis"/><text x="{x0 - 8:.1f}" y="{y + 4:.1f}" class="tick end">{mm}</text>')
    x1 = left + scale * max(sign * low, sign * high)
    out.append(f'<text x="{x0:.1f}" y="26" class="title">{title}</text>')
    out.append(f'<path d="M{x0:.1f} {top - 160 * scale}V{top}H{x1:.1f}" class="axis"/>')
    name = "xyz"[across]
    out.append(f'<text x="{(x0 + x1) / 2:.1f}" y="{top + 38}" class="tick">{name} [mm]</text>')
    out.append(f'<text x="{x0 - 8:.1f}" y="{top - 160 * scale - 10:.1f}" class="tick end">z [mm]</text>')
    out.append(f'<polygon points="{" ".join("%.1f,%.1f" % place(t) for t in TIPS)}" class="triangle"/>')
    for i, points in enumerate(FINGERS):
        colour = COLOURS[i]
        path = " ".join("%.1f,%.1f" % place(p) for p in points)
        dash = ' stroke-dasharray="10 6"' if across == 0 and i == 1 else ""
        out.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="7" stroke-linejoin="round" stroke-linecap="round"{dash}/>')
        for p in points[:-1]:
            out.append('<circle cx="%.1f" cy="%.1f" r="7" fill="white" stroke="%s" stroke-width="3"/>' % (*place(p), colour))
        out.append('<circle cx="%.1f" cy="%.1f" r="5" fill="%s"/>' % (*place(points[-1]), colour))
    cx, cy = place(CENTROID)
    out.append(f'<path d="M{cx - 7:.1f} {cy:.1f}h14m-7 -7v14" stroke="#333" stroke-width="2"/>')
    return out, place


def main():
    assert abs(PITCH - 0.759) < 5e-4, PITCH
    assert 80 <= CENTROID[0] <= 86, CENTROID
    side, s = view(0, "From the side (y away from the viewer)", 130, 1)
    front, f = view(1, "From the front (x towards the viewer)", 830, 1)

    def label(place, point, text, dx, dy, colour="#333", anchor="start"):
        x, y = place(point)
        return f'<text x="{x + dx:.1f}" y="{y + dy:.1f}" fill="{colour}" text-anchor="{anchor}" class="label">{text}</text>'

    first, third = FINGERS[0], FINGERS[2]
    mid = lambda a, b: (a + b) / 2
    labels = [
        label(s, mid(first[0], first[1]), "l1 39.0", -12, 4, "#555", "end"),
        label(s, mid(first[1], first[2]), "l2 46.0", 12, 12, "#555"),
        label(s, mid(first[2], first[3]), "l3 51.78", -8, -12, "#555", "end"),
        label(s, first[3], "fingers 1, 2", 14, 2, COLOURS[0]),
        label(s, third[1], "finger 3", -50, -14, COLOURS[2], "middle"),
        label(s, mid(third[0], third[1]), "39.0", 0, 24, "#555", "middle"),
        label(s, mid(third[1], third[2]), "46.0", 14, 8, "#555"),
        label(s, mid(third[2], third[3]), "51.78", 14, 4, "#555"),
        label(s, CENTROID, "centroid, x = %.1f" % CENTROID[0], 14, -10),
        label(f, FINGERS[0][0], "root (0, 40, 37.5)", 14, 4, COLOURS[0]),
        label(f, FINGERS[1][0], "root (0, −40, 37.5)", 0, 26, COLOURS[1], "middle"),
        label(f, third[0], "root (25, 0, 20)", 12, 18, COLOURS[2]),
        label(f, FINGERS[0][3], "finger 1", 0, -12, COLOURS[0], "middle"),
        label(f, FINGERS[1][3], "finger 2", 0, -12, COLOURS[1], "middle"),
        label(f, third[3], "finger 3", 14, 0, COLOURS[2]),
    ]
    # Gravity, 45° in the x–z plane.
    labels.append('<path d="M545 130l-52 52" stroke="#333" stroke-width="3" marker-end="url(#tip)"/>')
    labels.append('<text x="520" y="120" class="label" fill="#333">gravity</text>')
    style = (
        "text{font-family:sans-serif}.title{font-size:17px;font-weight:bold}.tick{font-size:12px;fill:#555;text-anchor:middle}"
        ".end{text-anchor:end}.label{font-size:13px}.axis{stroke:#888;fill:none}"
        ".triangle{fill:#f0e442;fill-opacity:.35;stroke:#998f00;stroke-dasharray:4 3}"
    )
    body = "\n".join(side + front + labels)
    marker = '<defs><marker id="tip" orient="auto" markerWidth="5" markerHeight="5" refX="3" refY="2.5"><path d="M0 0L5 2.5L0 5z" fill="#333"/></marker></defs>'
    OUT.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1070 530"><style>{style}</style>{marker}'
        f'<rect width="1070" height="530" fill="white"/>\n{body}\n</svg>\n'
    )
    print(f"pitch {PITCH:.4f} rad, centroid {CENTROID.round(2)}, tips {TIPS.round(2).tolist()}")


if __name__ == "__main__":
    main()
