"""Look at the built site in a browser: ``python docs/check_widths.py out/docs``.

At the widths of a phone, a laptop and two screens no page may be wider than its window, and no code
may be cut. Figures may not be cut from 1200 pixels on; a phone scrolls them sideways, so that their
text stays readable, and tables that programs print. Of the API's pages, which are alike, every
tenth is looked at. Without Chromium nothing is checked, which is said.
"""

import shutil
import sys
from pathlib import Path

#: Widths of windows, pixels, and what must not be cut there.
WIDTHS = {
    390: "pre:not(.output pre)",
    1200: "pre, .figure-frame",
    1440: "pre, .figure-frame",
    1920: "pre",
}
CUT = """
const cut = [...document.querySelectorAll(arguments[0])].filter(
  element => element.clientWidth > 0 && (element.scrollWidth > element.clientWidth + 1 ||
    element.scrollHeight > element.clientHeight + 1))
if (document.documentElement.scrollWidth > window.innerWidth + 1) cut.push(document.body)
return cut.map(element => `${element.tagName} ${element.innerText.trim().slice(0, 50)}`)
"""


def faults(site: Path, driver_path: str, browser: str) -> list[str]:
    """Return a line for every page with something that is cut."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.add_argument("--hide-scrollbars")
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver_path))
    found = []
    try:
        pages = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
        alike = [path for path in pages if "api" in path.relative_to(site).parts]
        for page in [path for path in pages if path not in alike] + alike[::10]:
            name = page.relative_to(site)
            driver.get(page.resolve().as_uri())
            for width, kinds in WIDTHS.items():
                size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
                driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
                cut = driver.execute_script(CUT, kinds)
                found += [f"{name}: cut at {width} pixels: {text}" for text in cut]
    finally:
        driver.quit()
    return found


if __name__ == "__main__":
    tools = shutil.which("chromedriver"), shutil.which("chromium")
    if None in tools:
        print("widths are not checked: no chromium or chromedriver here")
    else:
        lines = faults(Path(sys.argv[1]), *map(str, tools))
        sys.exit("\n".join(lines) or None)
