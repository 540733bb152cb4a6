"""JAX's CUDA plugin on a machine without a GPU."""

import sys

from jexplore.engine import plugins


def test_a_plugin_without_a_gpu_is_kept_quiet(monkeypatch, tmp_path):
    """With a plugin and no driver, JAX is kept to the CPU, unless a platform is set."""
    (tmp_path / "jax_plugins" / "xla_cuda13").mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(sys, "platform", "linux")
    for name in [name for name in sys.modules if name.split(".")[0] == "jax_plugins"]:
        monkeypatch.delitem(sys.modules, name)
    assert plugins.is_idle(driver=(str(tmp_path / "nvidiactl"),))
    assert not plugins.is_idle(driver=(str(tmp_path),))
    monkeypatch.setattr(plugins, "is_idle", lambda: True)
    for before, after in ((None, "cpu"), ("cuda", "cuda")):
        monkeypatch.delenv("JAX_PLATFORMS", raising=False)
        if before is not None:
            monkeypatch.setenv("JAX_PLATFORMS", before)
        plugins.keep_to_cpu()
        assert plugins.os.environ["JAX_PLATFORMS"] == after
