"""Opens a page in headless Chromium, where there is one."""

import html
import re
import shutil
import subprocess

import pytest

# Virtual time draws no frames of its own accord.
TIMERS = "<script>window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16);</script>"


def opener(folder):
    """A function that opens a page, text, and gives the data attributes of its body.

    Args:
      folder: an empty one, for the page and the browser's profile.
    """
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on the path")

    def opened(text, fragment=""):
        path = folder / "page.html"
        path.write_text(text, encoding="ascii")
        command = [browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
        command += ["--virtual-time-budget=10000", "--dump-dom", path.as_uri() + fragment]
        dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
        (tag,) = re.findall(r"<body[^>]*>", dom)
        return {name: html.unescape(value) for name, value in re.findall(r'data-(\w+)="(.*?)"', tag)}

    return opened
