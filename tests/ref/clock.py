"""Oracle for the robot's clock: what it did, in order, as milliseconds, in plain loops."""

import math


def _reach_s(way, speed, acceleration):
    """Seconds to the end of a way from standing, without braking."""
    until_fast = speed / acceleration
    rest = way - acceleration * until_fast**2 / 2
    return until_fast + rest / speed if rest > 0 else math.sqrt(2 * way / acceleration)


def stop_s(way, speed, acceleration):
    """Seconds over a way from standing to standing: speeding up for a half, and braking."""
    return 2 * _reach_s(way / 2, speed, acceleration)


def share(way, speed, acceleration):
    """Thousandths of the kinetic energy at full speed that the robot has at most."""
    return 1000 * min(speed, math.sqrt(way * acceleration)) ** 2 / speed**2


def play(events, robot, cell_m):
    """Clock after every step, and in the end: `(ms after the last scan at each place, ms in the end, starts, now)`.

    `now`: ms, as if the robot did not brake in the end.

    Events are ("turn", eighths), ("step", diagonal), ("scan",) in place, ("plan",), and ("wait",) for a step's time.
    """
    stood, starts, run, along = 0, 0, [], [0]  # ms and sum at the last stop; lengths of the steps since, cells

    def length_m():
        return cell_m * len(run) * (run[0] if run else 1)

    def stop(wait_s):
        nonlocal stood, starts
        if run:
            starts += round(share(length_m(), robot.speed_m_s, robot.acceleration_m_s2))
            stood += round(1000 * stop_s(length_m(), robot.speed_m_s, robot.acceleration_m_s2))
        stood += round(1000 * wait_s)
        run.clear()

    for kind, *what in events:
        if kind == "turn":
            stop(stop_s(what[0] * math.pi / 4, robot.turn_rad_s, robot.turn_acceleration_rad_s2))
        elif kind == "scan":
            stop(robot.scan_s)
        elif kind == "plan" and robot.plan_s:
            stop(robot.plan_s)
        elif kind == "wait":
            stop(stop_s(cell_m, robot.speed_m_s, robot.acceleration_m_s2))
        elif kind == "step":
            run.append(math.sqrt(2) if what[0] else 1)
            along.append(0)
        if kind in ("scan", "step"):
            reached_s = _reach_s(length_m(), robot.speed_m_s, robot.acceleration_m_s2) if run else 0
            along[-1] = stood + round(1000 * reached_s)
    now = stood + round(1000 * _reach_s(length_m(), robot.speed_m_s, robot.acceleration_m_s2) if run else 0)
    stop(0)
    return along, stood, starts, now
