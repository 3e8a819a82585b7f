"""A headless Chromium, where there is one."""

import shutil
from pathlib import Path

import pytest

webdriver = pytest.importorskip("selenium.webdriver")
_BROWSER, _DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
NEEDED = pytest.mark.skipif(
    not (_BROWSER and _DRIVER),
    reason="needs chromium and chromedriver (apt install chromium-driver)",
)
PHONE, SCREEN = 400, 1400

DRAWN = """
const found = [];
const walk = (node) => {
  for (const child of node.querySelectorAll("*")) {
    if (child.tagName === "CANVAS" && child.width && child.height) found.push(child);
    if (child.shadowRoot) walk(child.shadowRoot);
  }
};
return [...document.querySelectorAll("figure")].map((figure) => {
  found.length = 0;
  walk(figure);
  const colours = new Set();
  for (const canvas of found) {
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    for (let at = 0; at < data.length; at += 4)
      if (data[at + 3] > 200) colours.add((data[at] << 16) | (data[at + 1] << 8) | data[at + 2]);
  }
  return [figure.getBoundingClientRect().width, found.length, [...colours]];
});
"""
"""Of each figure: its width, its canvases, and the colours that are on them."""


def start_browser(folder: Path):
    """Start one that keeps what its console says and what it asks for."""
    options = webdriver.ChromeOptions()
    options.binary_location = _BROWSER
    for flag in (
        "headless=new",
        "no-sandbox",
        "disable-gpu",
        "disable-dev-shm-usage",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        "no-first-run",
        f"user-data-dir={folder}",
    ):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options, webdriver.ChromeService(_DRIVER))
