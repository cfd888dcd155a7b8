"""Algorithm 6 and r_m of eq. 2 as literal loops."""

import math

import numpy as np


def visibility(points, n_psi, rho):
    """Alg. 6, with psi the direction from p_j to p_i, as Alg. 5 and the text need it."""
    vis = np.full((len(points), n_psi), np.inf)
    for i, p_i in enumerate(points):  # 1
        for j, p_j in enumerate(points):  # 2
            d = math.hypot(p_j[0] - p_i[0], p_j[1] - p_i[1])  # 3
            if i == j or d == 0 or d > rho:
                continue
            psi = math.atan2(p_i[1] - p_j[1], p_i[0] - p_j[0])  # 4
            k = math.floor(psi / (2 * math.pi / n_psi) + 0.5) % n_psi
            vis[j][k] = min(d, vis[j][k])  # 5
    return vis


def ray(occupied, x, y, psi, max_range, step=0.01):
    """Walk from (x, y) in cells until an occupied cell; max_range if there is none."""
    height, width = occupied.shape
    t, cos, sin = 0.0, math.cos(psi), math.sin(psi)
    while t < max_range:
        column, row = math.floor(x + t * cos), math.floor(y + t * sin)
        if 0 <= column < width and 0 <= row < height and occupied[row, column]:
            return t
        t += step
    return max_range
