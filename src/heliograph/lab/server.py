"""The local server behind the page: it hands out files and drives experiments; nothing leaves the machine."""

from __future__ import annotations

import json
import socket
import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from heliograph.errors import ConfigError, HeliographError, MissingDependencyError, OutputError
from heliograph.lab.experiment import Experiment, ExperimentRun, ExperimentView
from heliograph.lab.experiments import EXPERIMENTS, find_experiment

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

__all__ = ["HOST", "Laboratory", "create_app", "free_socket", "serve"]

HOST = "127.0.0.1"
_PORTS_TRIED = 20
PATIENCE = 0.07
"""How long an answer waits for the engine [s]; then it says that the engine is still at it, and is asked again."""
_MAX_RUNS = 12  # begun experiments that are kept; the one used longest ago goes first
_MAX_BODY = 10_000  # bytes of a request
_KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_PAGE = ("index.html", "lab.js", "charts.js", "lab.css", "icon.svg")
# The drawing library compiles its shaders' helpers; nothing is ever fetched from elsewhere.
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' data: blob:; worker-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
EXTRA = "the lab needs starlette, uvicorn and plotly; install them with `pip install 'heliograph[lab]'`"


@dataclass(slots=True)
class _Begun:
    """An experiment under way, and what the engine does for it or has done last."""

    experiment: Experiment
    run: ExperimentRun | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    job: Future[dict[str, Any]] | None = None
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def busy(self) -> bool:
        """Whether the engine is at it."""
        return self.job is not None and not self.job.done()


class Laboratory:
    """The experiments that have been begun, by number.

    The engine works in threads of its own and an answer waits for it no longer than `PATIENCE`: most steps are done by
    then; a search for a place that was lost takes a second, and is told as such until it is.
    """

    def __init__(self) -> None:
        self._runs: OrderedDict[int, _Begun] = OrderedDict()
        self._count = 0
        self._lock = threading.Lock()
        self._engine = ThreadPoolExecutor(max_workers=_MAX_RUNS, thread_name_prefix="lab")

    def begin(self, name: str, given: dict[str, Any]) -> dict[str, Any]:
        """Begin an experiment and return its number and first view."""
        experiment = find_experiment(name)
        settings = experiment.settings(given)
        begun, oldest = _Begun(experiment), None
        with self._lock:
            self._count += 1
            number = self._count
            self._runs[number] = begun
            if len(self._runs) > _MAX_RUNS:
                _, oldest = self._runs.popitem(last=False)
        if oldest is not None:
            self._let_go(oldest)
        with begun.lock:
            return self._answer(number, begun, "begin", settings)

    def close(self) -> None:
        """Release what the runs hold."""
        with self._lock:
            runs = list(self._runs.values())
            self._runs.clear()
        for begun in runs:
            self._let_go(begun)
        self._engine.shutdown()

    def act(self, number: int, action: str, given: dict[str, Any]) -> dict[str, Any]:
        """Take a step of a run, or with the action ``"show"`` only look at it, and return its view.

        While the engine is still at what it was asked before, whatever is asked is answered by that.
        """
        with self._lock:
            begun = self._runs.get(number)
            if begun is None:
                raise ConfigError(f"run {number} is not there any more; begin again")
            self._runs.move_to_end(number)
        settings = begun.experiment.settings(given)
        if action != "show":
            begun.experiment.action(action)
        with begun.lock:
            return self._answer(number, begun, action, settings)

    def _answer(self, number: int, begun: _Begun, action: str, settings: dict[str, Any]) -> dict[str, Any]:
        """Return what the engine makes of an action, or that it is still at one."""
        known = begun.job is not None and action == "show" and begun.settings == settings
        if not (begun.busy or known):
            begun.settings, begun.job = settings, self._engine.submit(_work, begun, action, settings)
        assert begun.job is not None
        wait([begun.job], PATIENCE)
        if begun.busy:
            view = ExperimentView(message="The engine is still at it …").as_dict()
            return {"run": number, "settings": begun.settings, "view": view, "pending": True}
        job = begun.job
        if job.exception() is not None:
            begun.job = None  # told once; the next look finds the run as it is
        return {"run": number, "settings": begun.settings, "view": job.result(), "pending": False}

    def _let_go(self, begun: _Begun) -> None:
        """Release what a run holds, as soon as the engine is done with it."""

        def release(_: object) -> None:
            if begun.run is not None:
                begun.run.release()

        with begun.lock:
            if begun.job is None:
                release(None)
            else:
                begun.job.add_done_callback(release)


def _work(begun: _Begun, action: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Do what was asked and return the view; runs in a thread of the engine."""
    if begun.run is None:
        begun.run = begun.experiment.begin(settings)
    elif action not in ("show", "begin"):
        begun.run.step(action, settings)
    return begun.run.view(settings).as_dict()


async def _body_of(request: Request) -> dict[str, Any]:
    """Return a request's object, or raise `ConfigError`."""
    raw = await request.body()
    if len(raw) > _MAX_BODY or request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise ConfigError(f"a request is JSON of at most {_MAX_BODY} bytes")
    try:
        found = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"a request is JSON: {error}") from None
    if not isinstance(found, dict) or not isinstance(found.get("settings", {}), dict):
        raise ConfigError("a request is an object with 'settings'")
    return found


def create_app(laboratory: Laboratory) -> Starlette:
    """Return the application: the page, its files, and the experiments over HTTP.

    Parameters
    ----------
    laboratory : Laboratory
        Where experiments are begun; `Laboratory.close` it in the end.

    Raises
    ------
    MissingDependencyError
        Without the extra ``lab``.
    """
    try:
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import JSONResponse, Response
        from starlette.routing import Route
    except ImportError:
        raise MissingDependencyError(EXTRA) from None
    library = plotly_source()
    headers = {"Content-Security-Policy": _POLICY, "X-Content-Type-Options": "nosniff", "Cache-Control": "no-cache"}

    def page(request: Request) -> Response:
        name = request.path_params.get("name", "") or "index.html"
        if name == "plotly.min.js":
            return Response(library, media_type=_KINDS["js"], headers=headers | {"Cache-Control": "max-age=86400"})
        if name not in _PAGE:
            return JSONResponse({"error": f"there is no page '{name}'"}, status_code=404, headers=headers)
        body = files("heliograph.lab").joinpath("page").joinpath(name).read_bytes()
        return Response(body, media_type=_KINDS[name.rpartition(".")[2]], headers=headers)

    def experiments(request: Request) -> Response:  # noqa: ARG001 - the route's
        return JSONResponse([experiment.as_dict() for experiment in EXPERIMENTS.values()], headers=headers)

    async def answer(request: Request, act: Callable[[dict[str, Any]], dict[str, Any]]) -> Response:
        from starlette.concurrency import run_in_threadpool

        try:
            found = await run_in_threadpool(act, await _body_of(request))
        except HeliographError as error:
            return JSONResponse({"error": str(error)}, status_code=400, headers=headers)
        return JSONResponse(found, headers=headers)

    async def begin(request: Request) -> Response:
        return await answer(
            request, lambda given: laboratory.begin(str(given.get("experiment", "")), given.get("settings", {}))
        )

    async def act(request: Request) -> Response:
        number = request.path_params["number"]
        return await answer(
            request, lambda given: laboratory.act(number, str(given.get("action", "show")), given.get("settings", {}))
        )

    return Starlette(
        routes=[
            Route("/api/experiments", experiments),
            Route("/api/runs", begin, methods=["POST"]),
            Route("/api/runs/{number:int}", act, methods=["POST"]),
            Route("/", page),
            Route("/{name}", page),
        ],
        # A page elsewhere whose name points here must not drive the lab.
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"], www_redirect=False)],
    )


def plotly_source() -> bytes:
    """Return the drawing library's script as the installed package ships it, or raise `MissingDependencyError`."""
    try:
        return files("plotly").joinpath("package_data").joinpath("plotly.min.js").read_bytes()
    except (ImportError, FileNotFoundError):
        raise MissingDependencyError(EXTRA) from None


def free_socket(port: int) -> socket.socket:
    """Return a listening socket on the first free port from ``port`` on; 0 lets the system choose.

    Raises
    ------
    ConfigError
        ``port`` is none.
    OutputError
        None of twenty is free.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port} is none; ports are 1 to 65535, and 0 lets the system choose")
    last = min(port + _PORTS_TRIED, 65536) if port else 1
    for candidate in range(port, last):
        candidate_socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        candidate_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            candidate_socket.bind((HOST, candidate))
            candidate_socket.listen(64)
        except OSError:
            candidate_socket.close()
            continue
        return candidate_socket
    raise OutputError(f"no port from {port} to {last - 1} is free on {HOST}; give another with --port")


def serve(app: Starlette, listening: socket.socket) -> None:
    """Serve until Ctrl-C."""
    try:
        import uvicorn
    except ImportError:
        raise MissingDependencyError(EXTRA) from None
    server = uvicorn.Server(
        uvicorn.Config(app, log_level="warning", lifespan="off", access_log=False, timeout_graceful_shutdown=1)
    )
    server.run(sockets=[listening])
