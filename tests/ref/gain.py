"""Oracle for a simulated look all round (Holz et al. 2010, section 3.2): the whole map's entropy, before less after."""

import math

import numpy as np

from . import beams, plans, simulator


def entropy_bits(hits, misses):
    """Entropy of one cell: -(p log2 p + (1 - p) log2 (1 - p)); 1 where nothing was observed."""
    if hits + misses == 0:
        return 1.0
    p = hits / (hits + misses)
    return -sum(q * math.log2(q) for q in (p, 1 - p) if q > 0)


def look(hits, misses, row, col, n_beams, fov_deg, range_cells, p_free=0.25, outline=None):
    """`(gain, unknown, known)` of one look all round from a cell.

    Beams stop at occupied cells; the map goes on unknown beyond its edge. With an outline, `(height, width)`, they also
    stop at its outermost cells, of which nothing new is learnt. All beams belong to one scan, with one miss in the
    robot's own cell.
    """
    margin = math.ceil(range_cells) + 1
    hits, misses = (np.pad(counts, margin) for counts in (hits, misses))
    row, col = row + margin, col + margin
    known, _, occupied = plans.classify(hits, misses, p_free)
    inside = np.ones(hits.shape, bool)
    if outline is not None:
        inside[:] = False
        inside[margin + 1 : margin + outline[0] - 1, margin + 1 : margin + outline[1] - 1] = True
    n = simulator.initial_scan_count(fov_deg)
    rays = [
        ray
        for i in range(n)
        for ray in beams.scan(occupied | ~inside, row, col, i * 360 / n, n_beams, fov_deg, range_cells)
    ]
    new_hits, new_misses = hits.copy(), misses.copy()
    beams.fold(new_hits, new_misses, row, col, rays)
    counts = known | inside  # an outermost cell that nobody has seen is a wall all the same

    def total(h, m):
        return sum(entropy_bits(int(h[cell]), int(m[cell])) for cell in zip(*np.nonzero(counts)))

    passed = {(row, col), *(cell for missed, _ in rays for cell in missed)}
    unknown = sum(not known[cell] for cell in passed)
    return total(hits, misses) - total(new_hits, new_misses), unknown, len(passed) - unknown
