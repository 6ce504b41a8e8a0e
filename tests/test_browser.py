"""Pages in a real browser: nothing from the network, no error, zoom, buttons and keys work, no sideways scrolling.

Needs Debian's chromium and chromium-driver; without them the tests are skipped, and say so.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pages import diagnosis_page, run_page
from selenium.webdriver import ActionChains, Chrome, ChromeOptions, Keys
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from vehicle_sbi.report.page.index import rows, write_index

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium here: apt-get install chromium chromium-driver"),
]
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --hide-scrollbars"
)
RANGE = "const r = Bokeh.documents[0].all_models; for (const m of r) if (m.type === 'Range1d') return [m.start, m.end];"
DRAWN = "document.documentElement.dataset.drawn === 'true' && Bokeh.documents.every((one) => one.is_idle)"
ALL_DRAWN = f"return {DRAWN} && Bokeh.documents.length === document.querySelectorAll('.chart').length"
WIDTHS = {"desktop": 1280, "phone": 390}
OPEN_MS = 5000.0  # until a page is drawn, at most, on a machine that is busy; alone it takes half a second


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    for kind in ("diagnosis", "run"):
        (folder / kind).mkdir()
        (folder / kind / "manifest.json").write_text("{}")
    diagnosis_page(folder / "diagnosis" / "report.html")
    run_page(folder / "run" / "report.html")
    write_index(folder / "index.html", rows([folder]))
    return {kind: folder / kind / "report.html" for kind in ("diagnosis", "run")} | {"index": folder / "index.html"}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    options = ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in FLAGS.split():
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('profile')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = Chrome(options=options, service=Service(str(DRIVER)))
    yield driver
    driver.quit()


def visit(browser: Chrome, file: Path, *, width: int = 1280, dark: bool = False, drawn: bool = True) -> list[str]:
    """Open a page and wait until it is drawn; the addresses that it asked for."""
    screen: dict[str, Any] = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    browser.get("about:blank")
    for kind in ("browser", "performance"):
        browser.get_log(kind)
    browser.get(file.as_uri())
    if drawn:
        WebDriverWait(browser, 20, 0.02).until(lambda one: one.execute_script(f"return {DRAWN}"))
    sent = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("screen", [*WIDTHS])
@pytest.mark.parametrize("kind", ["diagnosis", "run", "index"])
def test_a_page_opens_without_network_or_error_and_never_scrolls_sideways(
    browser: Chrome, files: dict[str, Path], kind: str, screen: str, dark: bool
) -> None:
    asked = visit(browser, files[kind], width=WIDTHS[screen], dark=dark, drawn=kind != "index")
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    browser.execute_script("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    if kind != "index":
        WebDriverWait(browser, 20, 0.02).until(lambda one: one.execute_script(ALL_DRAWN))
    wide = browser.execute_script("return document.documentElement.scrollWidth")
    assert wide <= WIDTHS[screen]
    assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []


def test_no_column_of_the_effects_is_cut_off_in_a_window_of_a_laptop(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["diagnosis"], width=1150)
    browser.execute_script("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    table = browser.find_element(By.CSS_SELECTOR, ".table[aria-label='All effects']")
    box, wide = (browser.execute_script(f"return arguments[0].{key}", table) for key in ("clientWidth", "scrollWidth"))
    assert wide <= box


@pytest.mark.parametrize("kind", ["diagnosis", "run"])
def test_a_page_is_open_and_drawn_soon(browser: Chrome, files: dict[str, Path], kind: str) -> None:
    visit(browser, files[kind])
    drawn = browser.execute_script("return performance.now()")
    loaded = browser.execute_script("return performance.getEntriesByType('navigation')[0].loadEventEnd")
    print(f"{kind}: {files[kind].stat().st_size / 1e6:.2f} MB, open after {loaded:.0f} ms, drawn within {drawn:.0f} ms")
    assert drawn < OPEN_MS


def seen(browser: Chrome) -> tuple[float, float]:
    start, end = browser.execute_script(RANGE)
    return start, end


def test_dragging_zooms_and_keys_zoom_move_and_show_all(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["diagnosis"])
    chart = browser.find_element(By.CSS_SELECTOR, ".chart")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
    whole = seen(browser)
    ActionChains(browser).move_to_element_with_offset(chart, -200, 0).click_and_hold().move_by_offset(300, 0).release(
    ).perform()  # fmt: skip
    WebDriverWait(browser, 5, 0.02).until(lambda one: seen(one) != whole)
    start, end = seen(browser)
    assert whole[0] < start < end < whole[1]
    browser.execute_script("arguments[0].focus()", chart)
    ActionChains(browser).send_keys("0").perform()
    assert seen(browser) == whole
    ActionChains(browser).send_keys("+").perform()
    half = seen(browser)
    assert half[1] - half[0] == pytest.approx((whole[1] - whole[0]) / 2)
    ActionChains(browser).send_keys(Keys.ARROW_RIGHT).perform()
    assert seen(browser)[0] == pytest.approx(half[0] + 0.2 * (half[1] - half[0]))


def test_the_wheel_turns_the_page_and_zooms_with_ctrl(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["diagnosis"])
    chart = browser.find_element(By.CSS_SELECTOR, ".chart")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
    whole, box = seen(browser), chart.rect
    top = browser.execute_script("return arguments[0].getBoundingClientRect().top", chart)
    at = {"x": box["x"] + box["width"] / 2, "y": top + box["height"] / 2, "deltaX": 0, "type": "mouseWheel"}
    browser.execute_cdp_cmd("Input.dispatchMouseEvent", at | {"deltaY": 40})
    assert seen(browser) == whole
    browser.execute_cdp_cmd("Input.dispatchMouseEvent", at | {"deltaY": -240, "modifiers": 2})
    WebDriverWait(browser, 5, 0.02).until(lambda one: seen(one) != whole)
    start, end = seen(browser)
    assert end - start < whole[1] - whole[0]


def test_a_curve_is_hidden_by_its_button(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["diagnosis"])
    count = "return [...Bokeh.documents[0].all_models].filter((m) => m.name === 'base' && m.visible).length"
    before = browser.execute_script(count)
    browser.find_element(By.CSS_SELECTOR, "button[data-curve=base]").click()
    channels = 3
    assert browser.execute_script(count) == before - channels
    assert browser.find_element(By.CSS_SELECTOR, "button[data-curve=base]").get_attribute("aria-pressed") == "false"


def test_colours_follow_the_scheme(browser: Chrome, files: dict[str, Path]) -> None:
    line = "return [...Bokeh.documents[0].all_models].find((m) => m.tags[0] === 'recorded').line_color"
    colours = []
    for dark in (False, True):
        visit(browser, files["diagnosis"], dark=dark)
        colours.append(browser.execute_script(line))
    assert len({str(colour) for colour in colours}) == 2


def test_a_folded_chart_is_drawn_once_it_is_opened(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["diagnosis"])
    assert browser.execute_script("return Bokeh.documents.length") == 1
    browser.execute_script("document.querySelector('details').open = true")
    WebDriverWait(browser, 5, 0.05).until(lambda one: one.execute_script("return Bokeh.documents.length") == 2)
    wide = "return document.querySelector('details [data-root-id] > *').getBoundingClientRect().width"
    WebDriverWait(browser, 5, 0.05).until(lambda one: one.execute_script(wide) > 600)


def test_an_index_is_searched(browser: Chrome, files: dict[str, Path]) -> None:
    visit(browser, files["index"], drawn=False)
    browser.find_element(By.ID, "find").send_keys("diagnosis")
    shown = [row.text for row in browser.find_elements(By.CSS_SELECTOR, "tbody tr") if row.is_displayed()]
    assert len(shown) == 1
