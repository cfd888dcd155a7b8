"""The paper's listings as literal loops: slow, obvious, and the oracle of the fast paths.

A. Censi, "A comparison of algorithms for likelihood approximation in Bayesian localization".
Only what the paper leaves to the reader is added, and marked: which cell a position falls
in, what lies off the map (nothing: a miss), and which points take part (finite ones; with a
usable normal where the listing uses the normal).

Frames and axes are those of the fast code: grid frame in metres, stacks (theta, row, column),
a pose of a stack is the centre of its cell.
"""

import math

import numpy as np

from imgloc import OrientedPoints


def oriented(xy, alpha, valid=None):
    n = len(xy)
    valid = np.ones(n, dtype=bool) if valid is None else valid
    return OrientedPoints(xy, alpha, np.full(n, 0.1), valid)


def oplus(p, x, y, theta):
    """``p ⊕ (x, y, theta)``: a rotation of theta followed by a translation (x, y)."""
    c, s = math.cos(theta), math.sin(theta)
    return c * p[0] - s * p[1] + x, s * p[0] + c * p[1] + y


def cell(position, resolution):
    """Row and column of the cell [c, c + 1) x [r, r + 1) that holds a position."""
    return math.floor(position[1] / resolution), math.floor(position[0] / resolution)


def centre(row, col, resolution):
    return (col + 0.5) * resolution, (row + 0.5) * resolution


def value(image, position, resolution):
    """The image at a position; 0 off the map."""
    r, c = cell(position, resolution)
    on_map = 0 <= r < image.shape[0] and 0 <= c < image.shape[1]
    return float(image[r, c]) if on_map else 0.0


def phi(v):
    """The direction of a vector, ``atan2(v.y, v.x)``."""
    return math.atan2(v[1], v[0])


def angle_bin(angle, n):
    """The nearest of n directions ``2 pi k / n``."""
    return math.floor(angle * n / (2 * math.pi) + 0.5) % n


def cbml(bmap, points, thetas, resolution):
    """Algorithm 1."""
    height, width = bmap.shape
    L = np.zeros((len(thetas), height, width))
    for k, theta in enumerate(thetas):  # l. 2
        for row in range(height):
            for col in range(width):
                x, y = centre(row, col, resolution)
                for p_i in points:  # l. 4
                    if np.isfinite(p_i).all():
                        L[k, row, col] += value(bmap, oplus(p_i, x, y, theta), resolution)  # l. 5
    return L


def cbml_faster(bmap, points, thetas, resolution):
    """Algorithm 2."""
    height, width = bmap.shape
    L = np.zeros((len(thetas), height, width))
    for k, theta in enumerate(thetas):  # l. 1
        for p_i in points:  # l. 2
            if not np.isfinite(p_i).all():
                continue
            p_rotated = oplus(p_i, 0.0, 0.0, theta)  # l. 3
            for row in range(height):  # l. 4
                for col in range(width):
                    x, y = centre(row, col, resolution)
                    L[k, row, col] += value(bmap, oplus(p_rotated, x, y, 0.0), resolution)  # l. 5
    return L


def cbml_o(vmap, points, thetas, resolution):
    """Algorithm 3; `vmap` (2, H, W) holds the x and the y component, `points` are oriented."""
    _, height, width = vmap.shape
    L = np.zeros((len(thetas), height, width))
    for k, theta in enumerate(thetas):  # l. 1
        for row in range(height):
            for col in range(width):
                x, y = centre(row, col, resolution)
                for p_i, alpha_i, valid in zip(points.xy, points.alpha, points.valid, strict=True):
                    if not (valid and np.isfinite(p_i).all()):
                        continue
                    position = oplus(p_i, x, y, theta)
                    v_1 = [value(component, position, resolution) for component in vmap]  # l. 3
                    v_2 = math.cos(alpha_i + theta), math.sin(alpha_i + theta)  # l. 4
                    L[k, row, col] += v_1[0] * v_2[0] + v_1[1] * v_2[1]  # l. 5
    return L


def ght(surface, points, n_theta, shape, resolution):
    """Algorithm 4."""
    return ght_v(surface, None, points, n_theta, shape, resolution)


def ght_v(surface, vis, points, n_theta, shape, resolution):
    """Algorithm 5, and 4 when `vis` is None.

    `vis` (M, n_psi) is absolute, as in the listing: ``vis[j, b]`` is the distance from p_j to
    the nearest obstacle in the direction ``2 pi b / n_psi`` of the grid frame.
    """
    L = np.zeros((n_theta, *shape))
    for j in range(len(surface)):  # l. 1
        if not (surface.valid[j] and np.isfinite(surface.xy[j]).all()):
            continue
        for i in range(len(points)):  # l. 2
            p_j, p_i = surface.xy[j], points.xy[i]
            if not (points.valid[i] and np.isfinite(p_i).all()):
                continue
            theta = surface.alpha[j] - points.alpha[i]  # l. 3
            rotated = oplus(p_i, 0.0, 0.0, theta)
            t = p_j[0] - rotated[0], p_j[1] - rotated[1]  # l. 4
            if vis is not None:
                psi = angle_bin(phi((t[0] - p_j[0], t[1] - p_j[1])), vis.shape[1])
                if not vis[j, psi] > math.hypot(*p_i):  # l. 5
                    continue
            r, c = cell(t, resolution)
            if 0 <= r < shape[0] and 0 <= c < shape[1]:
                L[angle_bin(theta, n_theta), r, c] += 1  # l. 6
    return L


def ght_v_once(surface, vis, points, n_theta, shape, resolution):
    """Algorithm 5 with Sec. VII's remark: one vote of each scan point in a cell."""
    L = np.zeros((n_theta, *shape))
    for i in range(len(points)):
        one = slice(i, i + 1)
        L += ght_v(surface, vis, points.select(one), n_theta, shape, resolution) > 0
    return L


def visibility(points, n_psi, horizon):
    """Algorithm 6; (M, n_psi), infinite where nothing lies within the horizon.

    The listing updates vis_j with the direction from p_i to p_j. What the text defines, "the
    distance from p_j to the nearest obstacle in direction psi", needs the direction from p_j
    to p_i, and that is computed here.
    """
    vis = np.full((len(points), n_psi), np.inf)
    for p_i in points:  # l. 1
        for j, p_j in enumerate(points):  # l. 2
            d = math.hypot(p_j[0] - p_i[0], p_j[1] - p_i[1])  # l. 3
            if d == 0 or d > horizon:
                continue
            psi = angle_bin(phi((p_i[0] - p_j[0], p_i[1] - p_j[1])), n_psi)  # l. 4
            vis[j, psi] = min(d, vis[j, psi])  # l. 5
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


def at(image, row, col, replicate):
    """A cell of an image; beyond its border the nearest one, or 0."""
    height, width = image.shape
    if replicate:
        return image[min(max(row, 0), height - 1), min(max(col, 0), width - 1)]
    return image[row, col] if 0 <= row < height and 0 <= col < width else 0.0


def blurred(image, sigma, replicate=False):
    """A sampled Gaussian of sum 1 laid on every cell, four deviations to either side."""
    radius = (round(8 * sigma + 1) | 1) // 2
    g = [math.exp(-(d**2) / (2 * sigma**2)) for d in range(-radius, radius + 1)]
    g = [w / sum(g) for w in g]
    for axis in (0, 1):
        out = np.zeros(image.shape)
        for row, col in np.ndindex(image.shape):
            for d, w in zip(range(-radius, radius + 1), g, strict=True):
                r, c = (row + d, col) if axis == 0 else (row, col + d)
                out[row, col] += w * at(image, r, c, replicate)
        image = out
    return image


def vmap_of_image(occupied, free, resolution, sigma, factor=1):
    """Gradient, the tensor's axis, the gradient's sign: the field of imgloc.features.gradients."""
    wall = blurred(occupied.astype(float), 1.0, replicate=True)
    gradient = np.zeros((2, *wall.shape))
    for row, col in np.ndindex(wall.shape):
        for d, weight in ((-1, 1), (0, 2), (1, 1)):
            for side in (-1, 1):
                gradient[0, row, col] -= side * weight * at(wall, row + d, col + side, True) / 8
                gradient[1, row, col] -= side * weight * at(wall, row + side, col + d, True) / 8
    xx, xy, yy = (blurred(gradient[a] * gradient[b], 2.0) for a, b in ((0, 0), (0, 1), (1, 1)))
    field = np.zeros((2, *(-(-n // factor) for n in wall.shape)))
    for row, col in np.ndindex(wall.shape):
        if not any(at(free, row + i, col + j, False) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            continue
        tensor = np.array([[xx[row, col], xy[row, col]], [xy[row, col], yy[row, col]]])
        axis = np.linalg.eigh(tensor)[1][:, -1]  # of the greater eigenvalue
        signed = axis @ gradient[:, row, col]
        field[:, row // factor, col // factor] += signed * axis / factor**2
    left = math.sqrt(max(0.0, (sigma / resolution) ** 2 - 1)) / factor
    if left > 0.1:
        field = np.stack([blurred(component, left) for component in field])
    peak = np.hypot(*field).max()
    return field / peak if peak > 0 else field
