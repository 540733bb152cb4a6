"""Linardakis et al. 2024: rounds in which robots explore mazes of 15 x 15 cells, by rules of theirs.

    python benchmarks/linardakis.py --runs 1000

Rules, of the paper (arXiv 2407.14218) and its code: robots move in turn, a cell a round along rows and columns, not
into a wall nor another robot; each sees two cells far in eight directions, up to the first wall; all have one map. What
is unknown counts as free, any unknown cell is a target, and is kept until it is known. The cost-utility rule chooses
among the nearest ones by distance from all robots and by what the way shows, and targets differ. A run ends when all
cells but the outermost are known, or no robot can move. Prints mean rounds, standard errors, those of the paper.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from jexplore.bench.tables import markdown

SIDE, VIEW = 15, 2  # cells
STEPS = (0, 1), (1, 0), (0, -1), (-1, 0)
RAYS = *STEPS, (1, 1), (1, -1), (-1, 1), (-1, -1)
LAMBDA = 1.0  # weight of what a way shows in the cost-utility rule
UNKNOWN, FREE, WALL = -1, 0, 1
ROBOTS = 1, 2, 4, 6, 8, 10
PAPER = {
    ("nearest", 0.15): (68.7, 38.8, 24.0, 16.8, 12.0, 9.0),
    ("cost-utility", 0.15): (56.6, 30.2, 15.1, 10.0, 7.6, 6.2),
    ("nearest", 0.85): (88.0, 49.0, 28.0, 19.7, 15.1, 12.1),
    ("cost-utility", 0.85): (86.7, 46.5, 24.2, 16.9, 13.1, 10.8),
}


def around(cell):
    """Return the four cells next to a cell."""
    return [(cell[0] + drow, cell[1] + dcol) for drow, dcol in STEPS]


def make_maze(draw, walls):
    """Draw a maze: `[SIDE, SIDE]`; free cells are opened up with a probability of 1 - `walls`."""
    maze, stack = np.full((SIDE, SIDE), WALL), [(1, 1)]
    maze[1, 1] = FREE
    while stack:
        row, col = stack[-1]
        ahead = [(row + 2 * a, col + 2 * b, row + a, col + b) for a, b in STEPS]
        ahead = [one for one in ahead if 0 < one[0] < SIDE and 0 < one[1] < SIDE and maze[one[:2]] == WALL]
        if ahead:
            *room, row, col = ahead[draw.integers(len(ahead))]
            maze[tuple(room)] = maze[row, col] = FREE
            stack.append(tuple(room))
        else:
            stack.pop()
    for cell in np.argwhere(maze == FREE):
        if draw.random() >= walls:
            for beside in around(cell):
                maze[beside] = FREE

    def close():
        maze[[0, -1]] = maze[:, [0, -1]] = WALL

    close()
    for cell in np.ndindex(SIDE - 2, SIDE - 2):  # what has walls on all sides could not be seen
        beside = around((cell[0] + 1, cell[1] + 1))
        if all(maze[one] == WALL for one in beside):
            for one in beside:
                maze[one] = FREE
    close()
    return maze


def rays(cell, grid, robots=()):
    """Yield cells seen from a cell along eight rays, up to the first wall or robot in a grid."""
    for drow, dcol in RAYS:
        for k in range(1, VIEW + 1):
            at = cell[0] + k * drow, cell[1] + k * dcol
            if not (0 <= at[0] < SIDE and 0 <= at[1] < SIDE):
                break
            yield at
            if grid[at] == WALL or at in robots:
                break


def distances(known, robots, start):
    """Return steps from a cell to others, by breadth: dict; unknown cells count as free."""
    steps, ring = {start: 0}, [start]
    while ring:
        after = []
        for cell in ring:
            for beside in around(cell):
                if beside not in steps and known[beside] != WALL and beside not in robots:
                    steps[beside] = steps[cell] + 1
                    after.append(beside)
        ring = after
    return steps


def way_to(steps, target, pick):
    """Return the cells of a shortest way, from the first step to the target: of equal steps `pick`'s, backwards."""
    way = [target]
    while steps[way[-1]] > 1:
        before = [cell for cell in around(way[-1]) if steps.get(cell) == steps[way[-1]] - 1]
        way.append(before[pick(len(before))])
    return way[::-1]


def normalised(values):
    """Return values from 0 to 1."""
    values = np.array(values, float)
    return (values - values.min()) / max(np.ptp(values), 1e-9)


def choose(rule, known, robots, robot, taken, pick):
    """Return the next target of a robot; its own cell for none."""
    steps = distances(known, robots, robot)
    targets = [cell for cell in map(tuple, np.argwhere(known == UNKNOWN)) if cell in steps and cell not in taken]
    if not targets:
        return robot
    least = min(steps[cell] for cell in targets)
    nearest = [cell for cell in targets if steps[cell] == least]
    if rule == "nearest":
        return nearest[-1]  # the last one, as in their code
    away = [sum(abs(row - r) + abs(col - c) for r, c in robots) for row, col in nearest]
    ways = [way_to(steps, cell, pick) for cell in nearest]
    shown = [sum(known[seen] == UNKNOWN for at in [robot, *way] for seen in rays(at, known, robots)) for way in ways]
    return nearest[np.argmax(normalised(away) + LAMBDA * normalised(shown))]


def choose_all(rule, known, robots, targets, pick):
    """Return the targets of all robots, new ones where they are known; by the cost-utility rule different ones."""
    targets, left = list(targets), np.count_nonzero(known == UNKNOWN)
    differ = rule != "nearest" and left >= len(robots)
    for i, robot in enumerate(robots):
        if targets[i] is None or known[targets[i]] != UNKNOWN:
            others = [target for j, target in enumerate(targets) if j != i and target and known[target] == UNKNOWN]
            targets[i] = choose(rule, known, robots, robot, others if differ else (), pick)
    return targets


def run(rule, walls, n, first, number):
    """Return the rounds of one run, and whether all was known then; `first`: of equal ways robots take the first."""
    draw = np.random.default_rng((number, n, round(100 * walls)))
    maze = make_maze(draw, walls)
    free = np.argwhere(maze == FREE)
    robots = [tuple(cell) for cell in free[draw.choice(len(free), n, replace=False)]]
    known = np.full(maze.shape, UNKNOWN)
    known[[0, -1]] = known[:, [0, -1]] = WALL

    def look(robot):
        known[robot] = FREE
        for at in rays(robot, maze):
            known[at] = maze[at]

    for robot in robots:
        look(robot)
    pick = (lambda _: 0) if first else draw.integers
    targets, rounds = choose_all(rule, known, robots, [None] * n, pick), 0
    while (known == UNKNOWN).any():
        rounds, moved = rounds + 1, False
        for i, target in enumerate(targets):
            others = [robot for j, robot in enumerate(robots) if j != i]
            steps = distances(known, others, robots[i])
            if steps.get(target, 0):
                robots[i], moved = way_to(steps, target, pick)[0], True
            look(robots[i])
        targets = choose_all(rule, known, robots, targets, pick)
        if not moved:
            break
    return rounds, not (known == UNKNOWN).any()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--first", action="store_true", help="of equally short ways take the first, not one at random")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(given.workers) as pool:
        for (rule, walls), paper in PAPER.items():
            for n, theirs in zip(ROBOTS, paper):
                found = list(pool.map(partial(run, rule, walls, n, given.first), range(given.runs), chunksize=25))
                rounds = np.array([one for one, _ in found])
                error = rounds.std(ddof=1) / np.sqrt(len(rounds))
                whole = f"{100 * np.mean([whole for _, whole in found]):.1f}%"
                ratio = f"{rounds.mean() / theirs:.3f}"
                rows.append(
                    [rule, f"{walls:g}", str(n), f"{rounds.mean():.1f} ({error:.1f})", f"{theirs:g}", ratio, whole]
                )
                print(*rows[-1], file=sys.stderr, flush=True)
    print(markdown(["rule", "walls", "robots", "rounds (se)", "paper", "ratio", "whole"], rows))


if __name__ == "__main__":
    main()
