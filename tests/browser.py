"""A real browser for tests of the operator page: chromium without a window, driven by selenium."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By


@contextmanager
def open_browser() -> Iterator[webdriver.Chrome]:
    """A window of 1400 by 1000 pixels; skips the test where there is no browser."""
    driver, binary = shutil.which("chromedriver"), shutil.which("chromium")
    if not driver or not binary:
        pytest.skip("no chromium or chromedriver: make browser")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for word in ("--headless=new", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(word)
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")  # it refuses to start as root with one
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    made = webdriver.Chrome(options, Service(driver))
    try:
        made.set_window_size(1400, 1000)
        yield made
    finally:
        made.quit()


def visit(browser: webdriver.Chrome, url: str) -> None:
    browser.get("about:blank")  # another fragment alone would not load the page anew
    browser.get_log("browser")
    browser.get(url)


def shown(browser: webdriver.Chrome, name: str) -> str:
    return browser.find_element(By.ID, name).text
