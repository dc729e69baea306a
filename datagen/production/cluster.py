"""Scenes made by the nodes of a Ray cluster, which all see the dataset's folder.

Ray hands out the scenes, and again those of a node that is lost; each of its processes keeps one of ours, which makes
scenes one after the other and is watched as on a single machine. Nodes may come and go.
"""

import os
import signal
import socket
from concurrent.futures import Future, wait
from dataclasses import replace
from functools import cache

import ray
from multilight.datagen.errors import RunStoppedError, UserError
from multilight.datagen.production.crew import Crew, Failed, Limits
from multilight.datagen.production.drivers import FOLDER
from multilight.datagen.production.worker import WorkerReport, WorkerSetup

PATIENCE = 10.0
"""Seconds to wait for the cluster to answer."""


class Cluster:
    """A Ray cluster; a scene takes one of its CPUs, and a GPU each where `gpu`."""

    def __init__(self, setup: WorkerSetup, limits: Limits, most: int, address: str, *, gpu: bool) -> None:
        """Join it, to make so many scenes at once at most; raises `UserError` where there is none."""
        handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            if address:  # Ray itself would wait for minutes
                host, _, port = address.rpartition(":")
                socket.create_connection((host, int(port)), timeout=PATIENCE).close()
            ray.init(address or "auto", log_to_driver=False, logging_level="ERROR")
        except (OSError, ValueError, RuntimeError) as error:
            raise UserError(
                f"no Ray cluster at {address or 'RAY_ADDRESS, nor on this machine'} ({error}); "
                "start one (`ray start --head`), or name one with --address HOST:PORT"
            ) from None
        for number, handler in handlers.items():  # Ray has put its own there
            signal.signal(number, handler)
        background = setup.config.background
        config = setup.config.model_copy(update={"background": background and background.resolve()})
        folders = tuple(folder.resolve() for folder in setup.asset_folders)
        self._setup = replace(setup, config=config, root=setup.root.resolve(), asset_folders=folders, threads=1)
        self._limits, self._resource = limits, "GPU" if gpu else "CPU"
        self._most = most
        self._make = ray.remote(num_cpus=1, num_gpus=int(gpu), max_retries=-1)(make_on_node)

    @property
    def count(self) -> int:
        """How many scenes the nodes make at once, at present."""
        return max(1, min(self._most, int(ray.cluster_resources().get(self._resource, 1))))

    def start(self, index: int, replace: bool) -> "Future[object]":
        """Hand out a scene."""
        future: Future[object] = self._make.remote(self._setup, self._limits, index, replace).future()
        return future

    def told(self, index: int, future: "Future[object]") -> WorkerReport | Failed:
        """Return what came of a scene; raises `RunStoppedError` where no scene can be made."""
        try:
            told = future.result()
        except ray.exceptions.RayError as error:
            return Failed(f"{type(error).__name__}: {error}")
        if isinstance(told, RunStoppedError):
            raise told
        assert isinstance(told, WorkerReport | Failed)
        return told

    def stop(self, *, at_once: bool) -> None:
        """Leave the cluster, which ends what is at work for this run."""
        ray.shutdown()


def make_on_node(
    setup: WorkerSetup, limits: Limits, index: int, replace: bool
) -> WorkerReport | Failed | RunStoppedError:
    """Make a scene on the node that this runs on; what would stop every scene is returned."""
    if not setup.address and not (setup.root / FOLDER / setup.token).exists():
        return RunStoppedError(f"{socket.gethostname()} does not see {setup.root}: all nodes need that folder")
    crew = _crew(setup, limits)
    future = crew.start(index, replace)
    wait([future])
    try:
        return crew.told(index, future)
    except RunStoppedError as error:
        return error


@cache
def _crew(setup: WorkerSetup, limits: Limits) -> Crew:
    return Crew(replace(setup, parent=os.getpid()), limits, 1)
