#!/usr/bin/env python3
"""A joint under state feedback on a disturbance observer, built from matrices: exact discretisation by the matrix
exponential, gains by Ackermann's formula. Reference values for tesaki::control::ErrorObserver."""

import numpy as np
from scipy.linalg import expm

from data_file import write

COLUMNS = """
A joint that starts 1 mrad off under 5 mN m, a row for each tick of 10 ms.
Rows: error [rad], effort [N m].
"""

T, J, W, WO = 0.01, 2.1e-4, 50.0, 120.0


def held(a, b):
    n = len(a)
    m = expm(np.block([[a, b], [np.zeros((1, n + 1))]]) * T)
    return m[:n, :n], m[:n, n:]


def ackermann(a, b, poles):
    n = len(a)
    reach = np.hstack([np.linalg.matrix_power(a, i) @ b for i in range(n)])
    coefficients = np.poly(poles)
    phi = sum(c * np.linalg.matrix_power(a, n - i) for i, c in enumerate(coefficients))
    return (np.eye(n)[-1:] @ np.linalg.inv(reach) @ phi).ravel()


# Error, its velocity, disturbance; J e'' = d - u.
A, B = held(np.array([[0, 1, 0], [0, 0, 1 / J], [0, 0, 0]]), np.array([[0], [-1 / J], [0]]))
C = np.array([[1.0, 0, 0]])
k = ackermann(A[:2, :2], -B[:2], [np.exp(-W * T)] * 2)
# Current estimator: correction x += l (y - C x) with poles of (I - l C) A.
l = np.linalg.inv(A) @ ackermann(A.T, C.T, [np.exp(-WO * T)] * 3)[:, None]

if __name__ == "__main__":
    x, estimate = np.array([[0.001], [0.0], [0.005]]), np.zeros((3, 1))
    rows = []
    for _ in range(40):
        estimate = estimate + l * (x[0, 0] - estimate[0, 0])
        u = estimate[2, 0] + k @ estimate[:2, 0]
        rows.append(f"    ({float(x[0, 0])!r}, {float(u)!r}),")
        x, estimate = A @ x + B * u, A @ estimate + B * u
    text = "&[\n" + "\n".join(rows) + "\n]\n"
    write("observer.in", __file__, COLUMNS, text)
