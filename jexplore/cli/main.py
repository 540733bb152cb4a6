"""The command line: `jexplore compare`, `explore`, `reproduce`, `segment`, `trace`, `worlds`,
`strategies`, `bench`.

Importing this loads neither jax nor numpy; every command imports what it needs when it runs. Wrong input ends with one
line and status 2 and leaves no files, an interruption with one line and status 130; a comparison or reproduction then
keeps what is finished.
"""

import dataclasses
import functools
import io
import os
import signal
import sys
import threading

from jexplore.cli.console import COMPILING, Out, note, progress_of, say, working
from jexplore.cli.options import (  # fmt: skip
    COMMANDS,
    STRATEGIES,
    Bench,
    Compare,
    Explore,
    Reproduce,
    Segment,
    Strategies,
    Trace,
    Worlds,
    default_worlds,
    help_text,
    parse,
)
from jexplore.config import InputError
from jexplore.version import __version__

FINISHING = "jexplore: computing statistics and drawing"


def main(argv=None):
    """Runs a command.

    Args:
      argv: list of text; by default the arguments of this process.

    Returns:
      The exit status: 0; 2 for wrong input; 1 where memory or the reader of the output is gone; 130 if interrupted.
    """
    own = argv is None
    if sys.stdout is None:  # closed by the shell
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    if own and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    arguments = sys.argv[1:] if own else list(argv)
    if own:
        sys.unraisablehook = _repeat_interrupt
    try:
        return _dispatch(arguments)
    except InputError as error:
        return say(f"jexplore: error: {' '.join(str(error).split())}", 2)
    except KeyboardInterrupt:
        status = say("jexplore: interrupted, nothing was written", 130)
        if own:
            os._exit(status)  # at once: a program that is being compiled cannot be stopped in another way
        return status
    except MemoryError:
        return say("jexplore: error: out of memory; use a larger --cell-m, fewer episodes or fewer --lanes", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains when it ends
        return 1
    except OSError as error:  # files are checked below: this is the standard output
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return say(f"jexplore: error: cannot write the output: {error.strerror or error}", 1)


def _repeat_interrupt(unraisable):
    """Python drops what is raised where nobody can catch it, as in the function that jax has called after every garbage
    collection: an interruption that falls there comes once more, a little later.
    """
    if unraisable.exc_type is KeyboardInterrupt:
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(unraisable)


def _dispatch(arguments):
    if not arguments:
        raise InputError(f"expected a command: {', '.join(COMMANDS)}; see jexplore --help")
    if arguments[0] in ("-h", "--help"):
        print(help_text(), end="")
    elif arguments[0] == "--version":
        print(f"jexplore {__version__}")
    else:
        try:
            options = parse(arguments)
        except SystemExit:  # help has been printed
            return 0
        status = _RUN[type(options)](options, arguments) or 0
        sys.stdout.flush()
        return status
    sys.stdout.flush()
    return 0


def _run_jobs(options, jobs):
    """Compiles and runs, with a note and a bar: a `batch.Report`."""
    from jexplore.exploration import batch

    batch.use_compilation_cache()
    engine = None if options.engine == "auto" else options.engine
    with working(sum(len(job.starts) for job in jobs), "episodes") as on_progress:
        return batch.run(
            jobs, options.lidar, options.episode, engine=engine, lanes=options.lanes, on_progress=on_progress
        )


def _finish(out, found, report, text, figures, record):
    """Writes and prints what `_compare` and `_reproduce` have in common. Returns the exit status.

    Args:
      out: `Out`.
      found: `Comparison`.
      report: `batch.Report`.
      text: the tables.
      figures: `{name: Figure}`.
      record: called with more entries of run.json, returns all.
    """
    from jexplore.report import plot, store

    record = record(
        episodes_per_s=found.episodes_per_s,
        compile_s=found.compile_s,
        run_s=found.run_s,
        engine=report.engine,
        devices=report.devices,
        lanes=report.lanes,
        useful=report.useful,
        useful_plans=report.useful_plans,
        interrupted=found.interrupted,
        worlds=[_describe(world) for world in found.worlds],
        summary=found.summary.to_dict("records"),
        warnings=found.warnings,
    )
    wrote = out.write(
        {
            "episodes.parquet": lambda path: store.write_parquet(found.episodes, path),
            **{name: functools.partial(plot.save_figure, figure) for name, figure in figures.items()},
            "run.json": lambda path: store.write_json(record, path),
        }
    )
    print(text)
    for line in found.warnings:
        print(f"warning: {line}")
    print(wrote)
    if report.interrupted:
        return say("jexplore: interrupted, what was finished was written", 130)
    return 0


def _compare(options, arguments):
    from jexplore.studies.comparison import assemble, prepare_jobs
    from jexplore.studies.league import LEAGUE_STRATEGIES, league_worlds

    out = Out(options, "compare")
    worlds, strategies = (league_worlds(), LEAGUE_STRATEGIES) if options.league else (default_worlds(), STRATEGIES)
    options = dataclasses.replace(
        options,
        worlds=worlds if options.worlds is None else options.worlds,
        strategies=strategies if options.strategies is None else options.strategies,
    )
    jobs = prepare_jobs(
        options.worlds,
        options.strategies,
        episodes=options.episodes,
        seed=options.seed,
        cell_m=options.cell_m,
        start=options.start,
        lidar=options.lidar,
        rules=options.episode,
    )
    report = _run_jobs(options, jobs)
    with note(FINISHING):
        found = assemble(jobs, report, options.episode)
        if options.league:
            return _finish_league(out, found, report, functools.partial(out.record, arguments, options))
        # Without any episode 0, as after an early interruption, there is no path to draw.
        figures = {"compare.png": found.compare_figure()} | ({"paths.png": found.paths_figure()} if found.first else {})
        record = functools.partial(out.record, arguments, options)
        return _finish(out, found, report, found.to_markdown(), figures, record)


def _finish_league(out, found, report, record):
    """Measures what a plan costs, and writes and prints the standings. Returns the exit status."""
    from jexplore.bench.plans import plan_costs
    from jexplore.report import plot_league
    from jexplore.studies.league import standings_table

    world, names, plan_ms = found.worlds[0], list(dict.fromkeys(found.episodes["strategy"])), {}
    if not report.interrupted:
        try:
            with note("jexplore: measuring what a plan costs; Ctrl-C leaves that out"):
                plan_ms = plan_costs(world, names)
        except (InputError, KeyboardInterrupt):
            print("warning: what a plan costs could not be measured", file=sys.stderr)
    text = standings_table(found.standings, plan_ms)
    if plan_ms:
        text += (
            f"\nms a plan: on one core, in {world.name}, {world.shape[1]} x {world.shape[0]} cells, every strategy on\n"
        )
        text += "the same maps, with the default scanner and rules\n"
    record = functools.partial(record, standings=found.standings.to_dict("records"), plan_ms=plan_ms)
    return _finish(out, found, report, text, {"league.png": plot_league.figure(found.standings)}, record)


def _reproduce(options, arguments):
    from jexplore.studies import reproduction

    out = Out(options, "reproduce")
    jobs = reproduction.prepare(
        options.paper,
        maps=options.maps,
        episodes=options.episodes,
        seed=options.seed,
        cell_m=options.cell_m,
        lidar=options.lidar,
        rules=options.episode,
    )
    report = _run_jobs(options, jobs)
    with note(FINISHING):
        found = reproduction.assemble(options.paper, options.maps, jobs, report, options.episode)
        tables, orderings = (table.to_dict("records") for table in (found.tables, found.orderings))
        entries = {"notes": found.notes, "tables": tables, "orderings": orderings}
        record = functools.partial(out.record, arguments, options, **entries)
        figures = {"reproduce.png": found.figure()}
        return _finish(out, found.comparison, report, found.to_markdown(), figures, record)


def _explore(options, arguments):
    from jexplore.config import require_whole
    from jexplore.report import plot, store
    from jexplore.studies.explore import prepare_job, run_job

    out = Out(options, "explore")
    require_whole("frames", options.frames, 1, 10_000)
    job = prepare_job(
        options.world,
        options.strategy,
        seed=options.seed,
        cell_m=options.cell_m,
        start=_start(options.start),
        lidar=options.lidar,
        rules=options.episode,
    )
    with note(COMPILING):
        found = run_job(job, options.lidar, options.episode)
    measures = {"world": found.world.name, "strategy": found.strategy, **found.measures}
    record = out.record(arguments, options, result=measures, compile_s=found.compile_s, run_s=found.run_s)
    with progress_of(min(len(found.final.rows), options.frames), "frames") as progress:
        wrote = out.write(
            {
                "episode.png": lambda path: plot.save_figure(found.figure(), path),
                "episode.gif": lambda path: found.save_gif(path, max_frames=options.frames, on_progress=progress.step),
                "run.json": lambda path: store.write_json(record, path),
            }
        )
    for name, value in measures.items():
        text = "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
        print(f"{name:<18} {text}")
    if found.measures["refused"]:
        print("warning: refused steps leave no trace: the animation lacks their scans until its last frame")
    print(wrote)


def _segment(options, arguments):
    from jexplore.config import require_whole
    from jexplore.exploration import batch
    from jexplore.report import plot, store
    from jexplore.report.plot_rooms import figure
    from jexplore.studies.segmentation import SHARES, segment_maps

    out = Out(options, "segment")
    if not options.maps:
        raise InputError("expected a map: map.png@0.05 (metres a pixel), map.yaml, or a generator such as office#3")
    require_whole("seed", options.seed, 0, 2**32 - 1)
    batch.use_compilation_cache()
    with working(len(options.maps) * (1 + len(SHARES) * options.partial), "maps") as on_progress:
        found = segment_maps(
            options.maps,
            truth=options.truth,
            variants=options.variant,
            partial=options.partial,
            cell_m=options.cell_m,
            prominence_m=options.prominence_m,
            gamma=options.gamma,
            metric=options.metric,
            lines=options.lines,
            seed=options.seed,
            on_progress=on_progress,
        )
    record = out.record(arguments, options, scores=found.scores.to_dict("records"))
    wrote = out.write(
        {
            "scores.parquet": lambda path: store.write_parquet(found.scores, path),
            "segments.png": lambda path: plot.save_figure(figure(found.pictures, found.scores), path),
            "run.json": lambda path: store.write_json(record, path),
        }
    )
    print(found.to_markdown())
    overflow = found.scores[found.scores["overflow"] > 0]
    for _, row in overflow.iterrows():
        print(
            f"warning: {row['map']}: {row['variant']}: {row['overflow']} Voronoi nodes or critical points did not fit"
        )
    print(wrote)


def _trace(options, arguments):
    from jexplore.cli import trace

    return trace.run(options, arguments)


def _start(text):
    """`random`, `world`, or `row,col,heading_deg` as integers."""
    if text in ("random", "world"):
        return text
    try:
        row, col, heading = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--start must be random, world or ROW,COL,HEADING_DEG, got {text!r}") from None
    return row, col, heading


def _describe(world):
    """What a table of worlds says about one."""
    rows, cols = world.shape
    rooms = None if world.rooms is None else int(world.rooms.max()) + 1
    return {
        "world": world.name,
        "rows": rows,
        "cols": cols,
        "cell_m": world.cell_m,
        "free_m2": world.free_m2,
        "rooms": rooms,
        "start": world.start,
    }


def _worlds(options, arguments):
    from jexplore.worlds import GENERATORS, generator_parameters

    if not options.worlds and options.out is None:
        print("Built-in worlds. A name may carry a seed and parameters: hospital#3:width_m=60,height_m=25\n")
        for name in GENERATORS:
            defaults = " ".join(f"{key}={value}" for key, value in generator_parameters(name).items())
            print(f"  {name:<10}{defaults}")
        print("\nMap files: map.yaml (ROS), map.png@16x16 (metres), map.png@0.05 (metres a pixel), map.map, plan.json")
        return
    from jexplore.report import plot, store
    from jexplore.studies.checks import ready_worlds

    out = Out(options, "worlds")
    with note("jexplore: loading worlds"):
        worlds = ready_worlds(options.worlds or tuple(GENERATORS), options.cell_m)
    described = [_describe(world) for world in worlds]
    rows = [("world", "cells", "metres", "free m²", "rooms", "start")]
    for world, about in zip(worlds, described):
        height, width = world.shape
        start = "-" if world.start is None else "{},{},{}".format(*world.start)
        size = f"{width * world.cell_m:.1f} x {height * world.cell_m:.1f}"
        n_rooms = "-" if about["rooms"] is None else str(about["rooms"])
        rows.append((world.name, f"{width} x {height}", size, f"{world.free_m2:.1f}", n_rooms, start))
    record = out.record(arguments, options, worlds=described)
    figure = plot.worlds_figure([(world.name, world) for world in worlds])
    wrote = out.write(
        {
            "worlds.png": lambda path: plot.save_figure(figure, path),
            "run.json": lambda path: store.write_json(record, path),
        }
    )
    print(_table(rows))
    print(wrote)


def _table(rows):
    """Rows of text as an aligned Markdown table; the first is the head."""
    rows = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    rows.insert(1, ["-" * width for width in widths])
    return "".join("| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths)) + " |\n" for row in rows)


def _strategies(options, arguments):
    from jexplore.policies import MODIFIERS, STRATEGIES, parameters_of

    rows = [("strategy", "goes to", "parameters", "source")]
    for name, entry in STRATEGIES.items():
        given = ", ".join(f"{key}={value}" for key, value in parameters_of(name).items())
        rows.append((name, entry.summary, given or "-", entry.source))
    print(_table(rows))
    print(_table([("modifier", "meaning"), *((f"+{name}", text) for name, text in MODIFIERS.items())]))
    print("Names are put together as strategy+modifier:parameter=value,..., such as closest+recheck")


def _bench(options, arguments):
    from jexplore import bench
    from jexplore.bench import plots, tables
    from jexplore.report import plot, store

    out = Out(options, "bench")
    plan = bench.prepare(
        worlds=options.worlds,
        strategies=options.strategies,
        engine=options.engine,
        batch_sizes=options.batch_sizes,
        sides=options.sides,
        episodes=options.episodes,
        repeat=options.repeat,
        quick=options.quick,
    )
    with progress_of(plan.total, "measurements") as progress:
        progress.update(0)
        report = bench.run(plan, cache=options.cache, on_progress=progress.update)
    figure = plots.figure(report)
    record = out.record(arguments, options, measured=report["settings"])
    wrote = out.write(
        {
            "bench.json": lambda path: store.write_json(report, path),
            "bench.png": lambda path: plot.save_figure(figure, path),
            "run.json": lambda path: store.write_json(record, path),
        }
    )
    print(tables.tables(report))
    print(f"\n{wrote}")


_RUN = {
    Compare: _compare,
    Explore: _explore,
    Reproduce: _reproduce,
    Segment: _segment,
    Trace: _trace,
    Worlds: _worlds,
    Strategies: _strategies,
    Bench: _bench,
}
