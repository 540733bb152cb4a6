"""The command `jexplore trace`."""

import dataclasses
import math
import os
import sys

from jexplore.cli.console import COMPILING, Out, note, say, working
from jexplore.config import InputError


def run(options, arguments):
    from jexplore.exploration import batch
    from jexplore.report import trace_tables
    from jexplore.studies import tracing

    out = Out(options, "trace")
    noise = options.noise if options.noise_m is None else dataclasses.replace(options.noise, range_m=options.noise_m)
    if options.from_episode:
        return _trace_episode(out, options, arguments)
    if options.strategy != type(options)().strategy:
        raise InputError("--strategy goes with --from-episode")
    plan = tracing.prepare(
        options.world,
        robot=options.robot,
        runs=options.runs,
        seed=options.seed,
        tuning=options.tuning,
        noise=noise,
        start=options.start,
        sweep=options.sweep,
        settings=options.settings,
        cell_m=options.cell_m,
        max_steps=options.max_steps,
    )
    workers = os.cpu_count() or 1
    batch.start_backend(workers)
    batch.use_compilation_cache()
    with working(plan.runs * plan.settings, "runs") as on_progress:
        found = tracing.execute(plan, workers=workers, on_progress=on_progress)
    if found.track is None:
        raise KeyboardInterrupt  # before the first run was finished
    files = _drawn(found)
    if options.animate and not found.report.interrupted:
        from jexplore.report import operator_view
        from jexplore.studies import trace_recording

        try:
            with working(len(found.track.truth), "steps") as on_progress:
                page = operator_view.page(trace_recording.record(plan, on_progress))
            files["btm.html"] = lambda path: path.write_text(page, encoding="utf-8")
        except KeyboardInterrupt:
            print("warning: interrupted, btm.html was left out", file=sys.stderr)
    text = trace_tables.tables(found.first) + "\n" + "\n".join(trace_tables.summary(found))
    rate = len(found.table) / found.report.run_s
    entries = {"runs_per_s": rate, "compile_s": found.report.compile_s, "run_s": found.report.run_s}
    return _finish_trace(out, out.record(arguments, options, **entries), files, text, found.report.interrupted)


def _drawn(found):
    """The pictures and tables of a `Traced`: `{name: writer}`."""
    from jexplore.report import plot, plot_traces, store
    from jexplore.studies import trace_recording

    plan, track = found.plan, found.track
    figure = plot_traces.figure(
        found.first,
        trace_recording.wall_lines(plan),
        trace_recording.moved(track.estimate, plan.world.origin_m),
        trace_recording.scan_points(plan, track),
        track.mode,
        trace_recording.MODE_NAMES,
        f"{plan.robot.name} in {plan.world.name}",
        pitch_deg=track.pitch * (180 / math.pi),
    )
    return {
        **_exchanged(found.first),
        "btm.png": lambda path: plot.save_figure(figure, path),
        "runs.parquet": lambda path: store.write_parquet(found.table, path),
    }


def _exchanged(found):
    """Files of a Behavioral Trace Map for other programs: `{name: writer}`."""
    from jexplore.report import store
    from jexplore.tracemap import export, json_form

    files = {"btm.json": lambda path: store.write_json(json_form.to_json(found), path)}
    if any(link.end >= 0 for link in found.links):  # a route needs an edge
        route = export.geojson(found)
        files["btm.geojson"] = lambda path: store.write_json(route, path)
    graph = export.graphml(found)
    return {**files, "btm.graphml": lambda path: path.write_text(graph, encoding="utf-8")}


def _finish_trace(out, record, files, text, interrupted=False):
    from jexplore.report import store

    wrote = out.write({**files, "run.json": lambda path: store.write_json(record, path)})
    print(text)
    print(wrote)
    if interrupted:
        return say("jexplore: interrupted, what was finished was written", 130)
    return 0


def _trace_episode(out, options, arguments):
    """A map from what an exploration episode has seen."""
    from jexplore.report import plot, trace_tables
    from jexplore.studies import trace_extraction

    plain, own = type(options)(), ("world", "strategy", "seed", "cell_m", "tuning", "out", "overwrite", "from_episode")
    for field in dataclasses.fields(options):
        if field.name not in own and getattr(options, field.name) != getattr(plain, field.name):
            option = field.name.replace("_", "-")
            raise InputError(f"--from-episode takes no --{option}: an episode's robot is that of `jexplore explore`")
    with note(COMPILING):
        found = trace_extraction.extracted(
            options.world,
            options.strategy,
            seed=options.seed,
            cell_m=options.cell_m,
            tuning=options.tuning,
        )
    files = {**_exchanged(found.map), "btm.png": lambda path: plot.save_figure(found.figure(), path)}
    text = trace_tables.tables(found.map) + "\n" + "\n".join(found.agreement())
    record = out.record(arguments, options, result=found.measures, agreement=found.agreement())
    return _finish_trace(out, record, files, text)
