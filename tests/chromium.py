"""A headless Chromium that remembers every console message and network request of a page."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest


class Page:
    """A web page in a browser without a network.

    Attributes
    ----------
    driver : selenium.webdriver.Chrome
        For whatever the methods here do not do.
    """

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(self, file: Path) -> None:
        """Load a file, and forget what the page before it did."""
        self.driver.get("about:blank")
        for log in ("browser", "performance"):
            self.driver.get_log(log)
        self.driver.get(file.resolve().as_uri())

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        """Value of a JavaScript expression as soon as it is true."""
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.driver, seconds).until(
            lambda driver: driver.execute_script(f"return {script}"), f"never true: {script}"
        )

    def drag(self, element: str, right: int, down: int) -> None:
        """Press the mouse in the middle of a CSS selector's element, move it, let it go."""
        from selenium.webdriver import ActionChains

        found = self.driver.find_element("css selector", element)
        steps = ActionChains(self.driver, duration=50).move_to_element(found).click_and_hold()
        for _ in range(5):
            steps.move_by_offset(right // 5, down // 5)
        steps.release().perform()

    def picture(self) -> np.ndarray[Any, Any]:
        """Screenshot, (ny, nx, 3) uint8."""
        from PIL import Image

        shot = Image.open(io.BytesIO(self.driver.get_screenshot_as_png()))
        return np.asarray(shot.convert("RGB"))

    def complaints(self) -> list[str]:
        """Warnings and errors of the console since the last call or `open`."""
        return [
            entry["message"]
            for entry in self.driver.get_log("browser")
            if entry["level"] in ("WARNING", "SEVERE")
        ]

    def requests(self) -> list[str]:
        """Addresses asked for since the last call or `open`, but the file's own and data in it."""
        messages = [
            json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")
        ]
        asked = [
            message["params"]["request"]["url"]
            for message in messages
            if message["method"] == "Network.requestWillBeSent"
        ]
        here = self.driver.current_url.split("#")[0]
        return [url for url in asked if url != here and not url.startswith(("data:", "blob:"))]


@pytest.fixture(scope="session")
def page() -> Iterator[Page]:
    """A page in Chromium; skips where Chromium, its driver or selenium is missing."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    driver_path, browser = shutil.which("chromedriver"), shutil.which("chromium")
    if driver_path is None or browser is None:
        pytest.skip("no chromium or chromedriver here; Debian's chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for argument in (
        "--headless=new",
        "--no-sandbox",  # which root cannot have
        "--disable-dev-shm-usage",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        "--window-size=1000,700",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(driver_path)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield Page(driver)
    finally:
        driver.quit()
