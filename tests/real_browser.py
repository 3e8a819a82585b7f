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
