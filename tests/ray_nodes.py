"""A Ray cluster on loopback in a process of its own, told what to do line by line: `add`, `kill NUMBER`, or the end.

Ray forks itself to start its servers, which in a process that has other threads may wait for ever.
"""

import shutil
import subprocess
import sys
from contextlib import suppress
from typing import Any

NODE: dict[str, Any] = {"num_cpus": 1, "object_store_memory": 80 << 20, "include_dashboard": False}
NOTICED_SOON = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 200, "health_check_failure_threshold": 5}


class RayNodes:
    """The cluster, seen from the test: so far a head that makes nothing itself, at `address`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.ray_nodes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.address = self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        for line in self._process.stdout:  # Ray says more than it is asked
            if line.startswith("answer"):
                return line.removeprefix("answer").strip()
        raise RuntimeError("the cluster ended")

    def _ask(self, words: str) -> None:
        assert self._process.stdin is not None
        print(words, file=self._process.stdin, flush=True)
        self._answer()

    def add(self) -> None:
        """Add a node; the first has the number 0."""
        self._ask("add")

    def kill(self, number: int) -> None:
        """Kill a node."""
        self._ask(f"kill {number}")

    def close(self) -> None:
        """End the cluster."""
        self._process.communicate(timeout=60)


def main() -> None:
    """Serve."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args=NODE | {"num_cpus": 0, "_system_config": NOTICED_SOON})
    files = cluster.head_node.get_session_dir_path()
    nodes: list[Any] = []
    print("answer", cluster.address, flush=True)
    with suppress(EOFError):
        while True:
            action, _, number = input().partition(" ")
            if action == "add":
                nodes.append(cluster.add_node(**NODE))
            else:
                cluster.remove_node(nodes[int(number)], allow_graceful=False)
            print("answer", flush=True)
    cluster.shutdown()
    shutil.rmtree(files)


if __name__ == "__main__":
    main()
