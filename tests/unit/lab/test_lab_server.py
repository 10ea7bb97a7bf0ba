"""The lab's server: what it hands out, what it refuses, and how it starts."""

import json
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
from dataclasses import replace

import pytest

from heliograph.cli.main import main
from heliograph.errors import ConfigError, MissingDependencyError, OutputError
from heliograph.lab import EXPERIMENTS
from heliograph.lab.experiment import ExperimentRun, ExperimentView
from heliograph.lab.server import HOST, Laboratory, create_app, free_socket

uvicorn = pytest.importorskip("uvicorn", reason="the lab needs the extra `lab`")


@pytest.fixture(scope="module")
def address():
    listening, laboratory = free_socket(0), Laboratory()
    server = uvicorn.Server(uvicorn.Config(create_app(laboratory), log_level="error", lifespan="off"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield f"http://{HOST}:{listening.getsockname()[1]}"
    server.should_exit = True
    thread.join(timeout=30)
    laboratory.close()


def ask(address, path, body=None, headers=None):
    """Return status, headers and body of a request; one with a body is posted as JSON."""
    data = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    request = urllib.request.Request(address + path, data, {"content-type": "application/json", **(headers or {})})
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, dict(answer.headers), answer.read()
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers), error.read()


def test_page_names_nothing_outside_itself(address):
    for name in ("", "index.html", "lab.js", "charts.js", "lab.css", "icon.svg"):
        status, headers, body = ask(address, f"/{name}")
        assert status == 200
        assert "default-src 'none'" in headers["content-security-policy"]
        text = body.decode().replace("http://www.w3.org/2000/svg", "")
        assert "://" not in text, name


def test_library_is_the_installed_packages(address):
    from importlib.resources import files

    assert ask(address, "/plotly.min.js")[2] == files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()


def test_experiments_are_offered_in_the_lessons_order(address):
    found = json.loads(ask(address, "/api/experiments")[2])
    assert [one["name"] for one in found] == list(EXPERIMENTS)


def test_slider_moved_gives_the_engines_numbers(address):
    status, _, body = ask(address, "/api/runs", {"experiment": "graph", "settings": {"measured": 13.0}})
    begun = json.loads(body)
    assert status == 200
    moved = json.loads(ask(address, f"/api/runs/{begun['run']}", {"settings": {"measured": 9.0}})[2])
    experiment = EXPERIMENTS["graph"]
    for answer, measured in ((begun, 13.0), (moved, 9.0)):
        settings = experiment.settings({"measured": measured})
        assert answer["view"] == json.loads(json.dumps(experiment.begin(settings).view(settings).as_dict()))


@pytest.mark.parametrize(
    ("path", "body", "words"),
    [
        ("/api/runs", {"experiment": "tunel"}, "'tunel' is unknown"),
        ("/api/runs", {"experiment": "graph", "settings": {"measured": "x"}}, "not a number"),
        ("/api/runs", {"experiment": "graph", "settings": []}, "an object with 'settings'"),
        ("/api/runs", b"{", "a request is JSON"),
        ("/api/runs", b"[" * 9_000, "a request is JSON"),
        ("/api/runs", b" " * 20_000, "at most 10000 bytes"),
        ("/api/runs/77", {"action": "step"}, "run 77 is not there any more"),
    ],
)
def test_bad_request_is_one_line(address, path, body, words):
    status, _, answer = ask(address, path, body)
    assert status == 400
    assert words in json.loads(answer)["error"]


class Slow(ExperimentRun):
    """A run whose steps wait until they are let go; a number counts them."""

    def __init__(self, _):
        self.steps, self.gate, self.released = 0, threading.Event(), threading.Event()

    def step(self, action, settings):
        assert self.gate.wait(timeout=60)
        if self.steps == 1:
            raise ConfigError("the second step is refused")
        self.steps += 1

    def view(self, settings):
        return ExperimentView(message=f"{self.steps} steps")

    def release(self):
        self.released.set()


def test_answer_does_not_wait_for_an_engine_that_takes_long(monkeypatch):
    run, laboratory = Slow({}), Laboratory()
    slow = replace(EXPERIMENTS["tunnel"], begin=lambda _: run)
    monkeypatch.setattr("heliograph.lab.server.find_experiment", lambda _: slow)
    number = laboratory.begin("tunnel", {})["run"]
    for action in ("step", "show", "step"):  # what is asked meanwhile takes no step of its own
        answer = laboratory.act(number, action, {})
        assert answer["pending"] and "still at it" in answer["view"]["message"]
    run.gate.set()
    while (answer := laboratory.act(number, "show", {}))["pending"]:
        pass
    assert answer["view"]["message"] == "1 steps"
    with pytest.raises(ConfigError, match="second step is refused"):
        laboratory.act(number, "step", {})
    assert laboratory.act(number, "show", {})["view"]["message"] == "1 steps", "a refusal is told once"
    run.gate.clear()
    assert laboratory.act(number, "step", {})["pending"]
    for _ in range(12):
        laboratory.begin("tunnel", {})
    assert not run.released.is_set(), "what the engine works on is not taken from it"
    run.gate.set()
    assert run.released.wait(timeout=60)
    laboratory.close()


def test_unknown_action_is_refused(address):
    number = json.loads(ask(address, "/api/runs", {"experiment": "graph"})[2])["run"]
    status, _, answer = ask(address, f"/api/runs/{number}", {"action": "jump"})
    assert status == 400 and "no action 'jump'; there are solve" in json.loads(answer)["error"]


def test_page_elsewhere_cannot_drive_the_lab(address):
    assert ask(address, "/api/experiments", headers={"host": "elsewhere.example"})[0] == 400
    status, _, answer = ask(address, "/api/runs", {"experiment": "graph"}, {"content-type": "text/plain"})
    assert status == 400 and "JSON" in json.loads(answer)["error"]


@pytest.mark.parametrize("path", ["/server.py", "/..%2fserver.py", "/page%2flab.js", "/nothing"])
def test_other_files_are_not_handed_out(address, path):
    assert ask(address, path)[0] == 404


def test_old_runs_make_room_for_new_ones():
    laboratory = Laboratory()
    numbers = [laboratory.begin("graph", {})["run"] for _ in range(14)]
    with pytest.raises(ConfigError, match="not there any more"):
        laboratory.act(numbers[0], "show", {})
    assert laboratory.act(numbers[-1], "show", {})["view"]["readings"]


def test_what_a_run_holds_is_released(monkeypatch):
    closed = []
    monkeypatch.setattr("heliograph.lab.two_poses.TwoPlaces.release", lambda run: closed.append(run))
    laboratory = Laboratory()
    for _ in range(13):
        laboratory.begin("graph", {})
    assert len(closed) == 1
    laboratory.close()
    assert len(closed) == 13


def test_port_in_use_gives_the_next():
    with free_socket(0) as first:
        port = first.getsockname()[1]
        with free_socket(port) as second:
            assert port < second.getsockname()[1] <= port + 20


def test_no_port_is_free_is_one_line(monkeypatch):
    def taken(*_):
        raise OSError

    monkeypatch.setattr(socket.socket, "bind", taken)
    with pytest.raises(OutputError, match="no port from 9000 to 9019 is free"):
        free_socket(9000)


def test_lab_says_which_port_and_that_no_browser_opened(monkeypatch, capsys):
    monkeypatch.setattr("heliograph.lab.server.serve", lambda _, listening: listening.close())
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    with free_socket(0) as first:
        port = first.getsockname()[1]
        assert main(["lab", "tunnel", "--port", str(port)]) == 0
    said = capsys.readouterr().out
    assert f"port {port} is in use; taking " in said
    assert "#tunnel (Ctrl-C ends it)" in said
    assert "no browser opened by itself" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["nothing"], "experiment 'nothing' is unknown"), (["--port", "99999"], "ports are 1 to 65535")],
)
def test_lab_refuses_in_one_line(arguments, words, capsys):
    assert main(["lab", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@pytest.mark.parametrize("module", ["starlette.applications", "plotly"])
def test_missing_extra_is_named(module, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=r"heliograph\[lab\]"):
        create_app(Laboratory())
    assert main(["lab", "--no-browser"]) == 2
    assert "pip install 'heliograph[lab]'" in capsys.readouterr().err
