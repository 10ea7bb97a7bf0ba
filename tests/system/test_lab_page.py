"""The lab in a browser: experiments open, controls move, numbers are the engine's, nothing leaves the page."""

import threading
import time

import pytest
from tests.browser import CHROMIUM, MISSING, Browser

from heliograph.lab import EXPERIMENTS
from heliograph.lab.server import HOST, Laboratory, create_app, free_socket

uvicorn = pytest.importorskip("uvicorn", reason="the lab needs the extra `lab`")
pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason=MISSING), pytest.mark.timeout(900)]

QUIET = "window.heliographLab && heliographLab.state.view && !heliographLab.state.busy && heliographLab.state.open.name"
SHOWN = (
    "Object.fromEntries([...document.querySelectorAll('#readings div')].map("
    "(box) => [box.dataset.reading, box.querySelector('dd').dataset.value]))"
)


@pytest.fixture(scope="module")
def address():
    listening, laboratory = free_socket(0), Laboratory()
    server = uvicorn.Server(uvicorn.Config(create_app(laboratory), log_level="error", lifespan="off"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield f"http://{HOST}:{listening.getsockname()[1]}/"
    server.should_exit = True
    thread.join(timeout=30)
    laboratory.close()


@pytest.fixture(scope="module", params=[(1400, False), (390, True)], ids=["wide-light", "phone-dark"])
def browser(request, tmp_path_factory, address):
    """One asks for less motion, which is the phone's."""
    width, dark = request.param
    options = {"width": width, "height": 900, "dark": dark, "still": dark, "patience": 240.0}
    with Browser(tmp_path_factory.mktemp("profile"), **options) as page:
        yield page
        assert page.complaints == []
        assert [url for url in page.requests if not url.startswith((address, "data:", "blob:", "about:"))] == []


def expected(name, settings, actions=()):
    """Return the readings as the Python API gives them, as the page writes them."""
    experiment = EXPERIMENTS[name]
    full = experiment.settings(settings)
    run = experiment.begin(full)
    for action in actions:
        run.step(action, full)
    return {reading["name"]: reading["value"] for reading in run.view(full).as_dict()["readings"]}


def same(shown, wanted):
    assert shown.keys() == wanted.keys()
    for name, value in wanted.items():
        if value is not None and not isinstance(value, str):
            assert float(shown[name]) == pytest.approx(value, rel=1e-12), name
        else:
            assert shown[name] == ("null" if value is None else value)


def opened(browser, address, name):
    browser.open("about:blank")
    browser.open(f"{address}#{name}")
    browser.wait_for(f"{QUIET} === '{name}'")


def slide(browser, name, value):
    browser.evaluate(
        f"(() => {{const e = document.getElementById('control-{name}'); e.value = '{value}';"
        "e.dispatchEvent(new Event('input', {bubbles: true}))})()"
    )
    browser.wait_for(QUIET)


def test_slider_moved_shows_the_engines_numbers(browser, address):
    opened(browser, address, "graph")
    same(browser.evaluate(SHOWN), expected("graph", {}))
    slide(browser, "measured", 12.5)
    slide(browser, "fix_sigma", 0.5)
    same(browser.evaluate(SHOWN), expected("graph", {"measured": 12.5, "fix_sigma": 0.5}))
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    names = browser.evaluate(
        "[...document.querySelectorAll('input, button')].every((e) => e.labels?.length || e.textContent)"
    )
    assert names, "every control has words"


def test_loop_is_driven_and_closed_by_keys_and_touch(browser, address):
    opened(browser, address, "loop")
    browser.evaluate("document.getElementById('experiment').focus()")
    for _ in range(3):
        browser.press("Space")
        browser.wait_for(QUIET)
    browser.tap("button[data-action=close]")
    browser.wait_for("document.getElementById('message').textContent.startsWith('The loop is closed')")
    same(browser.evaluate(SHOWN), expected("loop", {}, ["drive"] * 3 + ["close"]))
    still = browser.evaluate("matchMedia('(prefers-reduced-motion: reduce)').matches")
    if not still:  # the correction is seen to go down the tree ...
        browser.wait_for("heliographLab.motion.frames > 3")
    browser.wait_for("heliographLab.state.view.charts[0].traces[2].frames.length > 2")
    browser.evaluate("new Promise((later) => setTimeout(later, 700))")
    assert (browser.evaluate("heliographLab.motion.frames") == 0) == still, "... but by those who asked for no motion"
    ended = "[...document.querySelector('figure[data-name=path] .plot').data.find((t) => t.name === 'estimate').x]"
    wanted = "heliographLab.state.view.charts[0].traces.find((t) => t.name === 'estimate').x"
    assert browser.evaluate(ended) == browser.evaluate(wanted), "and ends at what the engine says"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name not in ("graph", "loop", "families")])
def test_every_experiment_runs_in_the_page_as_in_python(browser, address, name):
    experiment = EXPERIMENTS[name]
    sliders = [c for c in experiment.controls if isinstance(c.default, float)]
    opened(browser, address, name)
    moved = {sliders[0].name: round(0.5 * (sliders[0].low + sliders[0].high) / sliders[0].step) * sliders[0].step}
    slide(browser, sliders[0].name, moved[sliders[0].name])
    for _ in range(4):
        browser.evaluate(f"heliographLab.act({experiment.actions[0].name!r})")
        browser.wait_for(QUIET)
    same(browser.evaluate(SHOWN), expected(name, browser.evaluate("heliographLab.settings()"), ["step"] * 4))
    assert browser.evaluate("document.querySelectorAll('.js-plotly-plot .main-svg').length") > 0


@pytest.mark.slow
def test_families_are_measured_in_the_page(browser, address):
    opened(browser, address, "families")
    for _ in range(60):  # twenty scans through each of the three
        browser.evaluate("heliographLab.act('step')")
    browser.wait_for(QUIET)
    shown = browser.evaluate(SHOWN)
    assert float(shown["ate_filter"]) < 20.0
    assert float(shown["ms_filter"]) > 0.0
