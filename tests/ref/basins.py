"""Rooms by the watershed of the clearance, one pass after the other: plain loops."""

import itertools

import numpy as np

from . import plans

AROUND = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)]


def clutter(free, size):
    """`[H, W]` bool: obstacles with a short diagonal, off the rim."""
    mask, obstacle = np.zeros(free.shape, bool), plans.clusters(~free)
    for number in range(obstacle.max() + 1):
        group = np.argwhere(obstacle == number)
        (r0, c0), (r1, c1) = np.min(group, axis=0), np.max(group, axis=0)
        off_rim = min(r0, c0) > 0 and r1 < free.shape[0] - 1 and c1 < free.shape[1] - 1
        if off_rim and (r1 - r0) ** 2 + (c1 - c0) ** 2 < size**2:
            mask[tuple(np.transpose(group))] = True
    return mask


def squared(sites, none):
    """`[H, W]` int, squared distance to the nearest site."""
    return plans.nearest_site(sites)[0] if sites.any() else np.full(sites.shape, none)


def peak_of(d2, inside, cell):
    """Return the peak that steepest ascent reaches from a cell."""

    def height(cell):
        return np.sqrt(np.float32(d2[cell]))

    while True:
        (r, c), best = cell, (np.float32(0), cell)
        for dr, dc in AROUND:
            there = r + dr, c + dc
            on_map = 0 <= there[0] < d2.shape[0] and 0 <= there[1] < d2.shape[1]
            if on_map and inside[there] and (inside[there[0], c] or inside[r, there[1]]):
                slope = (height(there) - height(cell)) * np.float32(1 if 0 in (dr, dc) else np.sqrt(0.5))
                best = max(best, (slope, there))
        if best[1] == cell:
            return cell
        cell = best[1]


def is_narrow(d2, inside, one, other, share):
    """Return whether the clearance between two cells side by side is below a share of that on both half circles round
    them, as large as the pass is wide.
    """

    def clearance(squared):
        return np.sqrt(np.float32(squared)) - np.float32(0.5)

    low, near = min(d2[one], d2[other]), []
    for at, sign in ((one, -1), (other, 1)):
        best = 0
        for angle in np.linspace(-np.pi / 2, np.pi / 2, 17, dtype=np.float32):
            ahead, aside = (int(np.round(np.sqrt(np.float32(low)) * f(angle))) for f in (np.cos, np.sin))
            move = (aside, sign * ahead) if one[0] == other[0] else (sign * ahead, aside)
            there = tuple(min(max(i + d, 0), n - 1) for i, d, n in zip(at, move, d2.shape))
            best = max(best, d2[there] if inside[there] else 0)
        near.append(best)
    return clearance(low) < np.float32(share) * clearance(min(near))


def watershed(free, unknown, *, ratio, narrowing, smallest, size, none=2**20):
    """`(label, doors, areas)`: `[H, W]` int, -1 outside; by room squared clearance of the way out, and area."""
    small = clutter(free, size)
    d2 = squared(~free & ~small & ~unknown, none)
    inside = free | small
    cells = [(int(r), int(c)) for r, c in np.argwhere(inside)]
    basin = {cell: peak_of(d2, inside, cell) for cell in cells}
    room = {peak: peak for peak in basin.values()}  # of every basin
    top = {peak: d2[peak] for peak in room}
    passes = [
        (-min(d2[a], d2[b]), *sorted((-d2[basin[a]], -d2[basin[b]])), axis, a, basin[a], basin[b])
        for axis, (dr, dc) in enumerate(((0, 1), (1, 0)))
        for a in cells
        if (b := (a[0] + dr, a[1] + dc)) in basin and basin[a] != basin[b]
    ]
    passes.sort()

    def clearance(squared):
        return np.sqrt(np.float32(squared)) - np.float32(0.5)

    def join(a, b):
        for one, of in room.items():
            if of == a:
                room[one] = b
        top[b] = max(top[a], top[b])

    for low, *_, axis, at, a, b in passes:
        one, other = room[a], room[b]
        beyond = at[0] + (axis == 1), at[1] + (axis == 0)
        if is_narrow(d2, inside, at, beyond, narrowing):
            continue
        if one != other and clearance(-low) >= np.float32(ratio) * clearance(min(top[one], top[other])):
            join(one, other)

    def area(of):
        return sum(1 for cell in cells if free[cell] and room[basin[cell]] == of)

    def wide_ways():
        """The widest pass out of every room: room -> pass, or None."""
        return {
            one: next((p for p in passes if room[p[-2]] != room[p[-1]] and one in (room[p[-2]], room[p[-1]])), None)
            for one in set(room.values())
        }

    while True:
        areas, wants = {one: area(one) for one in set(room.values())}, {}
        for one, way in wide_ways().items():
            if areas[one] < smallest and way:
                (other,) = {room[way[-2]], room[way[-1]]} - {one}
                if areas[other] >= smallest or (areas[one], one) < (areas[other], other):
                    wants[one] = other
        if not wants:
            break
        for one, other in wants.items():
            if one not in wants.values():
                join(one, other)
    way_out = wide_ways()
    label = np.full(free.shape, -1)
    rooms = sorted(set(room.values()))
    for cell in cells:
        if free[cell]:
            label[cell] = rooms.index(room[basin[cell]])
    doors = [-way_out[one][0] if way_out[one] else 0 for one in rooms]
    return label, doors, [area(one) for one in rooms]


def turned(mask):
    """The eight turns and mirror images of a mask, and how to undo each: pairs."""
    for k, mirrored in itertools.product(range(4), (False, True)):
        yield (
            np.rot90(mask[:, ::-1] if mirrored else mask, k),
            lambda found, k=k, mirrored=mirrored: np.rot90(found, -k)[:, ::-1] if mirrored else np.rot90(found, -k),
        )
