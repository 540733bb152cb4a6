"""Settings of all tests: no jit unless marked `jit`, one folder of compiled programs, no display."""

import contextlib
import ctypes
import functools
import gc
import os
import signal
import tempfile
from pathlib import Path

import jaxlib.version

os.environ["MPLBACKEND"] = "Agg"
os.environ.pop("JEXPLORE_SMALL", None)
# Compiling is what tests wait for, and their worlds are tiny: the cheapest code will do. It gives the same integers.
# Looking for what could move out of loops takes a quarter of the time, and both cores have a program of their own.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1 "
    "--xla_disable_hlo_passes=while-loop-invariant-code-motion,simplify-while-loops,while-loop-trip-count-annotator"
    # Later versions end the process at a flag that they do not know.
    + (" --xla_cpu_use_fusion_emitters=false" if jaxlib.version.__version_info__ < (0, 11, 2) else ""),
)

import hypothesis
import hypothesis.configuration
import jax
import pytest

from jexplore.engine import devices, plugins

hypothesis.settings.register_profile("jexplore", deadline=None, print_blob=True)
hypothesis.settings.load_profile("jexplore")


try:  # the C library keeps freed memory in pieces; this returns it
    _trim = ctypes.CDLL(None).malloc_trim
except AttributeError:  # another C library
    _trim = int

# JAX makes a context for each program and keeps it: 1.4 MB and some ms, more than an operation outside of jit needs.
# One serves all programs until they are dropped.
try:
    from jax._src.interpreters import mlir

    mlir.make_ir_context = _context = functools.cache(mlir.make_ir_context)
except (AttributeError, ImportError):  # another JAX
    _context = functools.cache(int)


RESIDENT_BYTES = 1_100_000_000  # up to which a worker keeps its programs
GROWTH_BYTES = 400_000_000  # by which it may grow beyond what was left when it dropped them last
_after_drop = 0
MOST_PROGRAMS = 200  # that a quick test with jit may compile, operations outside of `jax.jit` included; most do 4
MOST_OPERATIONS = 500  # without jit, where each operation of each shape is a program: an episode has 422
_compiled = 0


def _resident_bytes():
    """Return the memory of this process; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


# What takes longest comes first, so that no worker is left with much at the end; neighbours share few programs, which
# two workers would compile at the same time.
LONG = (
    *("mission", "docs", "slam_logs", "engines", "gym", "outline", "decisions", "tracing", "training", "sweep"),
    *("uncertain", "episode", "notebooks", "own_strategies", "resume", "bounds", "examples", "joined", "drive"),
)


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run the slow tests as well")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Long files first, slow tests only with `--all`. With `--dist loadgroup` a file's tests stay together, except
    notebooks, which share nothing.
    """
    if not config.getoption("--all"):
        slow = [item for item in items if item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if not item.get_closest_marker("slow")]

    def turn(item):
        name = item.path.stem.removeprefix("test_")
        return LONG.index(name) if name in LONG else len(LONG)

    items.sort(key=turn)
    for item in items:
        if item.path.stem != "test_notebooks":
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


def pytest_collection_finish():
    """Freeze the garbage collector's view of the collected tests, and collect less often while programs are traced."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


def pytest_configure(config):
    """Compiled programs are kept from run to run, for the processes that tests start as well; so is the CPU, where a
    plugin for compiling only is installed.
    """
    plugins.keep_to_cpu()
    jax.config.update("jax_platforms", os.environ.get("JAX_PLATFORMS"))
    folder = Path(_folder(config))
    os.environ["XDG_CACHE_HOME"] = str(folder)  # libraries built of native code
    hypothesis.configuration.set_hypothesis_home_dir(folder / "hypothesis")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder / "jax")
    jax.config.update("jax_compilation_cache_dir", str(folder / "jax"))
    jax.config.update("jax_disable_jit", True)
    # A shell that starts the tests in the background lets processes ignore Ctrl-C, those that tests start as well.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


_passing = tempfile.TemporaryDirectory(prefix="jexplore-tests-")  # goes with the process


def _folder(config):
    """Return the folder of compiled programs: pytest's cache, or one for these tests where that cannot be written."""
    with contextlib.suppress(AttributeError, OSError):  # without pytest's cache; in a checkout that can only be read
        folder = config.cache.mkdir("programs")
        if os.access(folder, os.W_OK):
            return folder
    return _passing.name


@contextlib.contextmanager
def _jit(on):
    # For all threads, where `jax.disable_jit` is for this one.
    before = jax.config.jax_disable_jit
    jax.config.update("jax_disable_jit", not on)
    try:
        yield
    finally:
        jax.config.update("jax_disable_jit", before)


@pytest.fixture(autouse=True)
def _jit_as_marked(request):
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # commands keep what takes long only
    with _jit(request.node.get_closest_marker("jit") is not None):
        yield


def _drop_programs():
    """Free the memory of compiled programs; they come back from the folder."""
    devices._compiled.cache_clear()
    jax.clear_caches()
    _context.cache_clear()
    gc.collect()
    _trim(0)


@pytest.fixture(autouse=True, scope="module")
def _garbage():
    """Drop a module's compiled programs."""
    yield
    _drop_programs()


@pytest.fixture(autouse=True)
def _memory():
    """Drop programs, within a module too, where a worker is large even without what compiling them has left behind."""
    global _after_drop
    yield
    most = max(RESIDENT_BYTES, _after_drop + GROWTH_BYTES)
    if _resident_bytes() > most:
        _trim(0)
    if _resident_bytes() > most:
        _drop_programs()
        _after_drop = _resident_bytes()


def _count(event, seconds, **_):
    global _compiled
    _compiled += event == "/jax/core/compile/backend_compile_duration"


jax.monitoring.register_event_duration_secs_listener(_count)


@pytest.fixture(autouse=True)
def _few_programs(request):
    """Fail a quick test that compiles more than it must: a program for every value, or shapes of its own."""
    before = _compiled
    yield
    most = MOST_PROGRAMS if request.node.get_closest_marker("jit") else MOST_OPERATIONS
    if _compiled - before > most and not request.node.get_closest_marker("slow"):
        pytest.fail(f"compiled {_compiled - before} programs, at most {most} may be: share shapes, or mark it slow")


@pytest.fixture(scope="session")
def jit_on():
    """A context manager that switches jit on: for fixtures of wider scope, which a test's mark does not reach."""
    return lambda: _jit(True)


@pytest.fixture(scope="session")
def maps():
    """Return the folder of downloaded maps, `shared/maps` next to the checkout."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "maps"
    if not folder.is_dir():
        pytest.skip(f"the maps are not there: no folder {folder}")
    return folder


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    """A function that opens a page in headless Chromium and gives the data attributes of its body."""
    from ref import browser

    return browser.opener(tmp_path_factory.mktemp("browser"))


@pytest.fixture
def ax():
    """Axes as large as their figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 3))
    yield figure.add_axes((0, 0, 1, 1))
    figure.clear()


@pytest.fixture
def forgetful():
    """Libraries are looked for anew, and warnings said again; afterwards as well."""
    from jexplore.native import build

    caches = build.build_library, build.told
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


@pytest.fixture
def printed(capsys):
    """A function that runs a command, which must end with a status, and returns what it prints: `.out` and `.err`."""
    from jexplore.cli import main

    def run(arguments, status=0):
        assert main.main(arguments) == status
        return capsys.readouterr()

    return run


@pytest.fixture
def refuses(printed):
    """A function that runs a command, which must end with status 2 and one line that says why, and returns the line."""

    def run(arguments, message):
        said = printed([str(argument) for argument in arguments], 2)
        line = said.err.replace("jexplore: loading worlds\n", "")
        assert said.out == ""
        assert line.startswith("jexplore: error: ")
        assert line.count("\n") == 1
        assert message in line
        return line

    return run
