"""Pictures of the monitor and of a report, for the README: run it in the folder of the project.

    .venv/bin/python docs/screenshots.py

It needs chromium and chromedriver.
"""

import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from selenium import webdriver

DOCS = Path(__file__).parent
SEFT = [sys.executable, "-m", "seft_ros.cli.main"]
DEMO = str(DOCS.parent / "config" / "demo.yaml")
WIDTH, HEIGHT, COLOURS = 1300, 1250, 64
HIDE = """
for (const name of arguments[0].split(",").filter(Boolean))
  document.getElementById(name).style.display = "none";
"""
DRAWN = "return window.Bokeh && Bokeh.documents.length && Bokeh.documents.every((d) => d.is_idle)"


def take_picture(
    browser: webdriver.Chrome, address: str, name: str, hidden: str = "", wait: float = 1.0
) -> None:
    """Open a page, wait until its figures are drawn, hide some sections, and save what is seen."""
    browser.set_window_size(WIDTH, HEIGHT)
    browser.get(address)
    while not browser.execute_script(DRAWN):
        time.sleep(0.1)
    browser.execute_script(HIDE, hidden)
    time.sleep(wait)
    browser.save_screenshot(str(DOCS / name))
    with Image.open(DOCS / name) as image:
        image.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(
            DOCS / name, optimize=True
        )


def main() -> None:
    """Run the demo twice: offline for the report, over ROS 2 beside the monitor."""
    options = webdriver.ChromeOptions()
    options.page_load_strategy = "none"  # a figure may still wait for its data
    for flag in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{flag}")
    with TemporaryDirectory() as folder, webdriver.Chrome(options) as browser:
        bag = Path(folder) / "simulated"
        subprocess.run([*SEFT, "simulate", DEMO, "--out", str(bag)], check=True)
        subprocess.run([*SEFT, "report", str(bag)], check=True)
        take_picture(
            browser,
            (bag / "report.html").as_uri(),
            "report.png",
            "what-was-tested,agreement-with-the-reference-response,the-equivalent-ground-motion",
        )
        monitor = subprocess.Popen([*SEFT, "monitor"], stdout=subprocess.PIPE, text=True)
        assert monitor.stdout is not None
        try:
            address = monitor.stdout.readline().split()[-1]
            subprocess.run([*SEFT, "run", DEMO, "--out", str(Path(folder) / "run")], check=True)
            take_picture(browser, address, "monitor.png", wait=5.0)
        finally:
            monitor.terminate()
            monitor.wait()


if __name__ == "__main__":
    main()
