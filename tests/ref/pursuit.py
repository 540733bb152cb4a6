"""Oracle for the differential drive: pure pursuit of a route in plain loops, in float64."""

import itertools
import math

import numpy as np

STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))


def _centre(cell):
    return np.array([cell[1] + 0.5, cell[0] + 0.5])


def _off(point, one, other):
    """Distance of a point from the way between two cells' centres."""
    one, other = _centre(one), _centre(other)
    way = other - one
    share = np.clip(np.dot(point - one, way) / np.dot(way, way), 0, 1) if way.any() else 0
    return math.dist(point, one + share * way)


class Rider:
    """A robot on a route: `x`, `y` in cells, `heading`, speeds in cells and radians a second."""

    def __init__(self, robot, cell_m, pose):
        self.x, self.y, self.heading = pose
        self.v = self.w = self.way = self.turned = self.braked = 0.0
        self.robot, self.cell_m, self.careful, self.anchor = robot, cell_m, False, None
        self.period_s = math.floor(min(200, 1000 * cell_m / robot.speed_m_s) + 1e-6) / 1000

    def tick(self, route, target, is_open):
        """Drive for one period; returns whether something stopped the robot. `route`: cell -> motion."""
        robot, dt = self.robot, self.period_s / 4
        top, faster = robot.speed_m_s / self.cell_m, robot.acceleration_m_s2 / self.cell_m
        lookahead, tolerance = robot.lookahead_m / self.cell_m, robot.tolerance_m / self.cell_m

        def after(cell):
            if cell == target or cell not in route:
                return cell
            return cell[0] + STEPS[route[cell]][0], cell[1] + STEPS[route[cell]][1]

        for _ in range(4):
            here = np.array([self.x, self.y])
            cells = [self.anchor]
            while cells[-1] != target and len(cells) < 1000:
                cells.append(after(cells[-1]))
            cells.append(target)
            lengths = np.cumsum([0.0, *(math.dist(*pair) for pair in itertools.pairwise(cells))])
            near = [
                (_off(here, *pair), -i)
                for i, pair in enumerate(itertools.pairwise(cells))
                if lengths[i] <= max(lookahead, 2)
            ]
            off, passed = min(near)
            self.anchor, k = cells[-passed], 1 - passed
            self.careful = off > tolerance or (self.careful and passed == 0)
            cells, ways = cells[k:], math.dist(here, _centre(cells[k])) + lengths[k:] - lengths[k]
            rest, far = ways[-1], [cell for cell, way in zip(cells, ways) if way >= lookahead]
            goal = _centre(cells[0] if self.careful else far[0] if far else target)
            distance = max(math.dist(here, goal), 1e-3)
            rest = math.dist(here, goal) if self.careful else rest
            aside = math.atan2(goal[1] - self.y, goal[0] - self.x) - self.heading
            aside = (aside + math.pi) % (2 * math.pi) - math.pi
            arrives = (math.floor(self.y), math.floor(self.x)) == target
            bend = 2 * math.sin(aside) / distance
            goes = abs(aside) < (0.1 if self.careful or self.v == 0 else math.pi / 3)
            v, w = 0.0, 0.0
            if goes and not arrives:
                v = min(top, math.sqrt(2 * faster * rest), robot.turn_rad_s / max(abs(bend), 1e-6))
                if self.careful or (goal == _centre(target)).all():
                    v = min(v, distance + 0.5)
            v = min(max(v, self.v - faster * dt), self.v + faster * dt)
            if not arrives:
                spin = min(
                    robot.turn_rad_s, math.sqrt(2 * robot.turn_acceleration_rad_s2 * abs(aside)), abs(aside) / dt
                )
                w = v * bend if goes else math.copysign(spin, aside)
            change = robot.turn_acceleration_rad_s2 * dt
            w = min(max(w, self.w - change), self.w + change)
            w = min(max(w, -robot.turn_rad_s), robot.turn_rad_s)
            middle = self.heading + w * dt / 2
            new = here + v * dt * np.array([math.cos(middle), math.sin(middle)])
            self.braked += max(self.v**2 - v**2, 0) / top**2
            self.v, self.w = v, w
            self.heading += w * dt
            self.turned += abs(w * dt)
            if not is_open(math.floor(new[1]), math.floor(new[0])):
                self.braked, self.v, self.w, self.careful = self.braked + v**2 / top**2, 0.0, 0.0, True
                return True
            self.x, self.y = new
            self.way += v * dt * self.cell_m
        return False
