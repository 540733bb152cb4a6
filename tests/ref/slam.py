"""Localisation by scans in plain numpy and scipy, written from the papers: Holz et al. 2010, Censi 2008, Olson 2009."""

import numpy as np
from scipy import optimize
from scipy.spatial import KDTree

ROOM = ((0, 0, 6, 0), (6, 0, 6, 4), (6, 4, 0, 4), (0, 4, 0, 0))
BOX = ((2, 2.6, 2.8, 2.6), (2.8, 2.6, 2.8, 3.2), (2.8, 3.2, 2, 3.2), (2, 3.2, 2, 2.6))
ANGLES = np.radians(np.linspace(-90, 90, 61))


def cast(pose, walls=ROOM + BOX, angles=ANGLES):
    """Ranges from a pose to walls, segments `x1 y1 x2 y2`; inf without a wall."""
    x1, y1, x2, y2 = np.array(walls, float).T[:, :, None]
    dx, dy = np.cos(pose[2] + angles), np.sin(pose[2] + angles)
    ex, ey = x2 - x1, y2 - y1
    det = ex * dy - ey * dx
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = (ex * (y1 - pose[1]) - ey * (x1 - pose[0])) / det
        s = (dx * (y1 - pose[1]) - dy * (x1 - pose[0])) / det
    return np.where((det != 0) & (t > 0) & (s >= 0) & (s <= 1), t, np.inf).min(axis=0)


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def ends(settings, ranges, angles, max_range_m=80.0, *, beams=5):
    """Ends, normals and validity of a scan: the line through a point and its neighbours by its scatter matrix."""
    valid = np.array([0 < r < max_range_m for r in ranges])
    xy = np.where(valid, np.nan_to_num(ranges, posinf=0, neginf=0), 0)[:, None] * np.c_[np.cos(angles), np.sin(angles)]
    normal = np.zeros_like(xy)
    for i in np.flatnonzero(valid):
        near = [
            j
            for j in range(max(i - beams, 0), min(i + beams + 1, len(xy)))
            if valid[j] and np.sum((xy[j] - xy[i]) ** 2) < settings.line_reach_m**2
        ]
        if len(near) < beams:
            continue
        (low, high), axes = np.linalg.eigh(np.cov(xy[near].T, bias=True))
        if low < settings.line_flatness * high:
            normal[i] = axes[:, 0] * (-1 if axes[:, 0] @ xy[i] > 0 else 1)
    return xy, normal, valid


def add(settings, stored, xy, valid, pose):
    """Points of the map, `[n, 2]`, after a scan: one after the other, the nearest to the scanner first.

    Distances are those of places in whole shares of the minimum distance.
    """
    stored, share_m = list(stored), settings.min_distance_m / 2048
    for i in sorted(np.flatnonzero(valid), key=lambda i: (np.sum(xy[i] ** 2), xy[i][0], xy[i][1])):
        point = rotation(pose[2]) @ xy[i] + pose[:2]
        if all(np.hypot(*(np.round(point / share_m) - np.round(other / share_m))) >= 2048 for other in stored):
            stored.append(point)
    return np.array(stored).reshape(-1, 2)


def middles(settings, xy, centre, shape):
    """Middles of the cells of places, `[n, 2]`."""
    cell, half = 0.7 * settings.min_distance_m, np.array(shape[::-1]) / 2
    return (np.floor((np.asarray(xy, float) - centre) / cell + half) + 0.5 - half) * cell + centre


def match(settings, points, normals, scan, start, prior, centre, shape, rounds=20):
    """Point-to-line ICP with the odometry as one more measurement; partners nearest to cells' middles."""
    xy, own, valid = scan
    tree, known, pose = KDTree(points), np.linalg.inv(prior), np.array(start, float)
    for k in range(rounds + 2):
        gate = max(settings.gate_m * (1.0, 0.7, 0.0)[min(k, 2)], settings.fine_gate_m)
        turn = rotation(pose[2])
        rows, off, weights = [], [], []
        for p, n in zip(xy[valid], own[valid]):
            q = turn @ p + pose[:2]
            i = tree.query(middles(settings, q, centre, shape))[1]
            d, m = np.hypot(*(q - points[i])), normals[i]
            if d >= gate or (m.any() and n.any() and m @ turn @ n <= np.cos(np.radians(settings.max_facing_deg))):
                continue
            aside = np.array([-(turn @ p)[1], (turn @ p)[0]])
            for axis in [m] if m.any() else np.eye(2):
                rows.append([*axis, axis @ aside])
                off.append(axis @ (q - points[i]))
            sd = settings.noise_m if m.any() else settings.isolated_m
            size = abs(off[-1]) / sd if m.any() else np.hypot(*off[-2:]) / sd
            weights += [1 / max(1, size / settings.huber) / settings.correlation / sd**2] * (1 if m.any() else 2)
        away = pose - start
        away[2] = (away[2] + np.pi) % (2 * np.pi) - np.pi
        a, r, w = np.array(rows).reshape(-1, 3), np.array(off), np.array(weights)
        step = np.linalg.solve(a.T @ (w[:, None] * a) + known, -known @ away - a.T @ (w * r))
        pose += step
        if k > 1 and np.abs(step).max() < settings.settled_m:
            break
    return pose


def picture(settings, points, centre, shape):
    """Costs of a point in every cell of a map, by the distance of its middle from the nearest point."""
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    xy = (np.stack([cols, rows], axis=-1) + 0.5 - np.array(shape[::-1]) / 2) * 0.7 * settings.min_distance_m + centre
    d = KDTree(points).query(xy)[0]
    return np.minimum(0.5 * (d / settings.search_blur_m) ** 2, settings.search_cap)


def search(settings, cost, centre, scan, start, prior, blocks, turns):
    """Least cost of a window, every pose tried: `(cost, pose)`."""
    xy, _, valid = scan
    height, width = cost.shape
    cell = 0.7 * settings.min_distance_m
    first = (np.asarray(start[:2]) - centre) / cell + np.array([width, height]) / 2
    sd, n = np.sqrt(np.diag(prior)), max(valid.sum(), 1)
    best = np.inf, None
    for k in range(-turns, turns + 1):
        turn = k * np.radians(settings.search_turn_deg)
        at = np.floor(xy[valid] @ rotation(start[2] + turn).T / cell + first).astype(int)
        for i in range(-6 * blocks, 6 * blocks):
            for j in range(-6 * blocks, 6 * blocks):
                row, col = at[:, 1] + i, at[:, 0] + j
                inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
                each = np.where(inside, cost[np.where(inside, row, 0), np.where(inside, col, 0)], settings.search_cap)
                away = np.array([j * cell, i * cell, turn]) / sd
                total = each.sum() / n + np.log1p(away @ away / 2) * settings.correlation / n
                if total < best[0] - 1e-7:
                    best = total, np.asarray(start) + np.array([j * cell, i * cell, turn])
    return best


def settle(poses, ends, moved, information):
    """Best fit of a pose graph, pose 0 fixed, by a general solver."""
    roots = [np.linalg.cholesky(one).T for one in information]

    def misfit(flat):
        own = np.concatenate([poses[:1], flat.reshape(-1, 3)])
        off = []
        for (i, j), move, root in zip(ends, moved, roots):
            xy = rotation(own[i, 2]).T @ (own[j, :2] - own[i, :2]) - move[:2]
            turn = own[j, 2] - own[i, 2] - move[2]
            off.append(root @ [*xy, np.arctan2(np.sin(turn), np.cos(turn))])
        return np.concatenate(off)

    found = optimize.least_squares(misfit, poses[1:].ravel(), xtol=1e-12, ftol=1e-12)
    return np.concatenate([poses[:1], found.x.reshape(-1, 3)])
